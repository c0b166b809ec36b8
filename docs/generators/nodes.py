# SPDX-License-Identifier: Apache-2.0
"""A page for each node: what it does, equations, topics, services, parameters; and the page of topics."""

import ast
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pam_orthosis
from generators import equations
from generators.declared import declared
from generators.markdown import first_sentence, table, value
from pam_orthosis.bag import topics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.scene import messages as scene
from pam_orthosis.scene import sampled

OF_KNEE = topics.Topics(KNEE)
NODES = Path(pam_orthosis.__file__).parent / "nodes"
FOLDER = "reference/nodes"
FIXED = "fixed for a run: set it before the start"  # as most are
LONGEST = 60  # characters of a default
RATES = {
    "step": "each control period",
    "slow": "each step of the position controller",
    "answer": "real time only",
    "1 Hz": "1 Hz",
    "event": "when it happens",
}


_SHOWN_RATE = f"{10**9 // scene.PERIOD_NS} Hz"
SHOWN = {
    scene.TF: ("where thigh, shank and the muscles' ends are", _SHOWN_RATE),
    scene.TF_STATIC: ("frames that do not move", "once, transient local"),
    scene.DESCRIPTION: ("the leg as URDF, also a parameter of the node", "once, transient local"),
    scene.JOINTS: ("hip and knee, rad; contraction of the muscles, m", _SHOWN_RATE),
    scene.MARKERS: ("the muscles: length, diameter, pressure by colour; their chains", _SHOWN_RATE),
}


class Described(NamedTuple):
    """A node: names in the table of topics, modules with its equations, in words."""

    roles: tuple[str, ...]
    modules: tuple[str, ...]
    words: str


EXECUTABLES = {
    "plant_simulator": Described(
        (topics.PLANT,),
        ("model.mechanisms.leg", "model.components.pneumatics", "model.components.muscle", "model.assembly"),
        """The emulated hardware: mechanics of the leg, two muscles by the braid's geometry, gas, valves, all
        effects that are on, sensors with noise and steps. It integrates one control period with the voltages
        held. In lockstep it publishes step k, waits for both voltages of step k, and advances. Its true state
        goes to the recorder alone.""",
    ),
    "trajectory_publisher": Described(
        (topics.TRAJECTORY,),
        ("control.trajectory",),
        """Publishes the angle to follow, with velocity and acceleration, one step before the instant for
        which it holds, at the steps of the position controller. The motion starts at rest; the cadence rises
        smoothly and may change during the run.""",
    ),
    "position_controller": Described(
        (topics.POSITION,),
        ("control.observer", "control.position", "control.axis"),
        """Observer and backstepping controller of the knee angle: from the measured angle and both pressures
        it estimates velocity and disturbance torque, and from these and the reference it computes the
        pressures that both muscles are to have.""",
    ),
    "pressure_controller": Described(
        tuple(OF_KNEE.controllers),
        ("control.pressure", "model.components.pneumatics"),
        """Backstepping controller of one muscle's pressure. It computes the mass flow that makes the pressure
        follow its reference, the change of volume by the motion included. Each muscle has one, and the knee's
        have executables of their own, `extensor_pressure_controller` and `flexor_pressure_controller`; that
        of another machine is
        `pressure_controller --ros-args -p muscle:=NAME -r __node:=NAME_pressure_controller`.""",
    ),
    "inverse_valve_model": Described(
        (topics.VALVE,),
        ("control.inverse_valve", "model.components.pneumatics"),
        """Computes the voltage of each valve from the wanted mass flow and the pressure: it inverts the flow
        law of the orifice and compensates hose and dead band.""",
    ),
    "safety_monitor": Described(
        (topics.SAFETY,),
        ("control.limits",),
        """Limits apart from the controllers, in runs with `--safety`: from measured angle, pressures and the
        valves' commands alone it allows the valves a pressure, and beyond a limit it stops those who own the
        valves as well.""",
    ),
    "bag_recorder": Described(
        (topics.RECORDER,),
        (),
        """Records all topics except those that manage the graph into an MCAP bag: messages as they came, log
        time = stamp, all parameters in the bag's metadata. It reports progress and ends the run.""",
    ),
}


def pages() -> dict[str, str]:
    """Return the pages."""
    made = {f"{FOLDER}/{name}.md": _page(name, one) for name, one in EXECUTABLES.items()}
    beside = [name for name in executables() if name not in EXECUTABLES]
    made |= {f"{FOLDER}/{name}.md": _page_beside(name) for name in beside}
    lines = [f"- [{name}]({name}.md): {_module_words(name)}" for name in (*EXECUTABLES, *beside)]
    index = (
        "# Nodes\n\nThe first six make one leg, with a safety monitor if it is wanted. Each runs"
        " in a process of its own, or all run in one process"
        " (`run --composed`). A page lists the parameters that the node declares; those of the apparatus"
        " ([muscle](../parameters/muscle.md), [valve](../parameters/valve.md), [leg](../parameters/leg.md),"
        " [effects](../effects/index.md)), which are the same for all, it declares when it is given them.\n\n"
    )
    return {f"{FOLDER}/index.md": index + "\n".join(lines) + "\n", **made}


def topic_table() -> str:
    """Return all topics of a run as a table."""
    head = ("topic", "meaning", "type", "unit", "published by", "subscribed by", "rate")
    return table(head, (_topic_row(topic) for topic in OF_KNEE.all))


def _topic_row(topic) -> tuple[str, ...]:
    listeners = [name for name in topic.subscribers if name != topics.RECORDER]
    to = "all other nodes" if len(listeners) > 3 else ", ".join(listeners)
    return (
        f"`{topic.name}`", topic.meaning, f"`{topic.type.replace('/msg/', '/')}`", topic.unit,
        "every node" if len(topic.producers) > 1 else topic.producers[0],
        ", ".join(filter(None, [to, "recorder" if topic.recorded else ""])),
        RATES["slow" if topic.slow else topic.rate],
    )  # fmt: skip


def scene_table() -> str:
    """Return the topics for viewers as a table."""
    rows = [(f"`{t}`", f"`{scene.TYPES[t].replace('/msg/', '/')}`", *SHOWN[t]) for t in scene.TYPES]
    return table(("topic", "type", "meaning", "rate"), rows)


def executables() -> list[str]:
    """Return the nodes that setup.py installs, one for all pressure controllers."""
    return [name for name in installed() if (NODES / f"{name}.py").exists()]


def installed() -> list[str]:
    """Return the nodes that setup.py installs."""
    setup = ast.parse((NODES.parents[1] / "setup.py").read_text(encoding="utf-8"))
    for statement in setup.body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == "NODES":
            return ast.literal_eval(statement.value)
    raise LookupError("setup.py has no NODES")


def _page(name: str, one: Described) -> str:
    beside = [t.name for t in OF_KNEE.all if t.optional] if topics.SAFETY in one.roles else []
    there = OF_KNEE.of_run(beside=beside).values() if beside else OF_KNEE.all
    published = [t for t in there if set(one.roles) & set(t.producers)]
    heard = [t for t in there if set(one.roles) & set(t.subscribers)]
    parts = [f"# {name}\n\n{' '.join(one.words.split())}\n"]
    if len(one.roles) > 1:
        parts.append(f"\nIn the graph: {', '.join(f'`{role}`' for role in one.roles)}.\n")
    cited = equations.of_modules(one.modules)
    if cited:
        rows = [(f"({number})", f"`{c.place}`", c.words) for number, c in cited]
        parts.append("\n## Equations\n\n" + table(("equation", "function", "use"), rows))
    parts += ["\n## Subscriptions\n\n", _topics(heard), "\n## Publications\n\n", _topics(published)]
    parts.append(_services(name))
    parts.append(_parameters(name))
    return "".join(parts)


def _page_beside(name: str) -> str:
    """Return the page of a node that is none of a leg's own: what it says of itself."""
    parts = [f"# {name}\n\n{_module_docstring(name)}\n"]
    if name == "leg_state_publisher":
        parts += ["\n## Subscriptions\n\n", _topics(OF_KNEE.by_name[topic] for topic in sampled.inputs(KNEE))]
        parts += ["\n## Publications\n\n", scene_table()]
    return "".join([*parts, _parameters(name)])


def _topics(some) -> str:
    rows = [
        (
            f"`{t.name}`",
            f"`{t.type.replace('/msg/', '/')}`",
            t.unit,
            t.meaning,
            RATES["slow" if t.slow else t.rate],
        )
        for t in some
    ]
    return table(("topic", "type", "unit", "meaning", "rate"), rows)


def _parameters(name: str) -> str:
    """Return the parameters that a node has declared which was made to be asked."""
    rows = [
        (f"`{p.name}`", _shown(p.value), p.meaning, p.constraints.removesuffix(FIXED).rstrip("; "))
        for p in declared(name)
    ]
    return "\n## Parameters\n\n" + table(("parameter", "default", "meaning", ""), rows)


def _shown(default: Any) -> str:
    plain = list(default) if isinstance(default, array) else default
    return "a text" if len(value(plain)) > LONGEST and isinstance(plain, str) else value(plain) or '""'


def _services(name: str) -> str:
    rows = [(f"`{one}`", "`std_srvs/Trigger`") for one in _offered(name)]
    return "\n## Services\n\n" + table(("service", "type"), rows) if rows else ""


def _offered(module: str) -> Iterator[str]:
    """Yield the services that a node's module offers."""
    for node in ast.walk(ast.parse((NODES / f"{module}.py").read_text(encoding="utf-8"))):
        offers = isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "offer"
        if offers and isinstance(node.args[0], ast.Constant):
            yield node.args[0].value


def _module_words(name: str) -> str:
    return first_sentence(_module_docstring(name))


def _module_docstring(name: str) -> str:
    words = ast.get_docstring(ast.parse((NODES / f"{name}.py").read_text(encoding="utf-8")))
    words = words.removeprefix("Node: ")
    return words[0].upper() + words[1:]
