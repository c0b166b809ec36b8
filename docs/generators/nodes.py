# SPDX-License-Identifier: Apache-2.0
"""A page for each node: what it does, equations, topics, services, parameters; and the page of topics."""

import ast
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pam_orthosis
from generators import equations
from generators.markdown import first_sentence, parameter_rows, table, value
from pam_orthosis.bag import topics
from pam_orthosis.control import inverse_valve, position, pressure, trajectory
from pam_orthosis.model import plant
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import SUBJECTS, Section, load
from pam_orthosis.nodes.layout import live_keys
from pam_orthosis.scene import messages as scene
from pam_orthosis.scene import sampled

OF_KNEE = topics.Topics(KNEE)
NODES = Path(pam_orthosis.__file__).parent / "nodes"
FOLDER = "reference/nodes"
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
    """A node: names in the table of topics, modules with its equations, what makes its core, in words."""

    roles: tuple[str, ...]
    modules: tuple[str, ...]
    core: Callable | None
    words: str


EXECUTABLES = {
    "plant_simulator": Described(
        (topics.PLANT,),
        ("model.mechanisms.leg", "model.components.pneumatics", "model.components.muscle", "model.assembly"),
        plant.Plant,
        """The emulated hardware: mechanics of the leg, two muscles by the braid's geometry, gas, valves, all
        effects that are on, sensors with noise and steps. It integrates one control period with the voltages
        held. In lockstep it publishes step k, waits for both voltages of step k, and advances. Its true state
        goes to the recorder alone.""",
    ),
    "trajectory_publisher": Described(
        (topics.TRAJECTORY,),
        ("control.trajectory",),
        trajectory.make_trajectory,
        """Publishes the angle to follow, with velocity and acceleration, one step before the instant for
        which it holds, at the steps of the position controller. The motion starts at rest; the cadence rises
        smoothly and may change during the run.""",
    ),
    "position_controller": Described(
        (topics.POSITION,),
        ("control.observer", "control.position", "control.axis"),
        position.PositionController,
        """Observer and backstepping controller of the knee angle: from the measured angle and both pressures
        it estimates velocity and disturbance torque, and from these and the reference it computes the
        pressures that both muscles are to have.""",
    ),
    "pressure_controller": Described(
        tuple(OF_KNEE.controllers),
        ("control.pressure", "model.components.pneumatics"),
        lambda p: pressure.PressureController(p, "extensor"),
        """Backstepping controller of one muscle's pressure. It computes the mass flow that makes the pressure
        follow its reference, the change of volume by the motion included. Each muscle has one.""",
    ),
    "inverse_valve_model": Described(
        (topics.VALVE,),
        ("control.inverse_valve", "model.components.pneumatics"),
        lambda p: inverse_valve.InverseValveModel(p, "extensor"),
        """Computes the voltage of each valve from the wanted mass flow and the pressure: it inverts the flow
        law of the orifice and compensates hose and dead band.""",
    ),
    "bag_recorder": Described(
        (topics.RECORDER,),
        (),
        None,
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
        "# Nodes\n\nThe first six make one leg. Each runs in a process of its own, or all run in one process"
        " (`run --composed`).\n\n"
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
    """Return the nodes that setup.py installs."""
    setup = ast.parse((NODES.parents[1] / "setup.py").read_text(encoding="utf-8"))
    for statement in setup.body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == "NODES":
            return ast.literal_eval(statement.value)
    raise LookupError("setup.py has no NODES")


def _page(name: str, one: Described) -> str:
    published = [t for t in OF_KNEE.all if set(one.roles) & set(t.producers)]
    heard = [t for t in OF_KNEE.all if set(one.roles) & set(t.subscribers)]
    parts = [f"# {name}\n\n{' '.join(one.words.split())}\n"]
    if len(one.roles) > 1:
        parts.append(f"\nIn the graph: {', '.join(f'`{role}`' for role in one.roles)}.\n")
    cited = equations.of_modules(one.modules)
    if cited:
        rows = [(f"({number})", f"`{c.place}`", c.words) for number, c in cited]
        parts.append("\n## Equations\n\n" + table(("equation", "function", "use"), rows))
    parts += ["\n## Subscriptions\n\n", _topics(heard), "\n## Publications\n\n", _topics(published)]
    parts.append(_services(name))
    parts.append("\n## Settings of the node\n\n" + _settings(name))
    if one.core:
        parts.append(_used(name, one.core))
    return "".join(parts)


def _page_beside(name: str) -> str:
    """Return the page of a node that is none of a leg's own: what it says of itself."""
    parts = [f"# {name}\n\n{_module_docstring(name)}\n"]
    if name == "leg_state_publisher":
        parts += ["\n## Subscriptions\n\n", _topics(OF_KNEE.by_name[topic] for topic in sampled.inputs(KNEE))]
        parts += ["\n## Publications\n\n", scene_table()]
    settings = _setting_rows(_calls(name, "Setting"))
    if settings:
        parts.append("\n## Settings of the node\n\n" + table(("parameter", "default", "meaning"), settings))
    return "".join(parts)


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


def _used(name: str, core: Callable) -> str:
    tree = load()
    with accessed() as keys:
        core(tree)
    live = live_keys(tree.declared).get(name, ())
    rows = {row.key: row for row in tree.rows()}
    fixed: dict[str, list[str]] = {}
    for key in (key for key in rows if key in keys and key not in live):
        fixed.setdefault(key.split(".")[0], []).append(f"`{key}`")
    words = "\n## Parameters\n\nThe node declares them as ROS parameters under these names.\n"
    if live:
        words += f"\nThese may be set while the node runs:\n\n{parameter_rows(rows[key] for key in live)}"
    lines = [f"- [{subject}](../{_page_of(subject)}): {', '.join(names)}" for subject, names in fixed.items()]
    return f"{words}\nThese are fixed when it starts:\n\n" + "\n".join(lines) + "\n"


def _page_of(subject: str) -> str:
    return f"parameters/{subject}.md" if subject in SUBJECTS else "effects/index.md"


@contextmanager
def accessed() -> Iterator[set[str]]:
    """Collect the dotted keys of all parameters that are read inside."""
    keys: set[str] = set()
    plain = Section.__getattribute__

    def noting(section, name):
        found = plain(section, name)
        if not name.startswith("_") and not isinstance(found, Section) and not inspect.ismethod(found):
            keys.add(f"{plain(section, '_path')}.{name}")
        return found

    Section.__getattribute__ = noting
    try:
        yield keys
    finally:
        Section.__getattribute__ = plain


def _settings(name: str) -> str:
    rows = _setting_rows([*_calls(name, "Setting"), *_calls("graph", "Setting")])
    return table(("parameter", "default", "meaning"), rows)


def _setting_rows(found) -> list[tuple[str, str, str]]:
    rows = []
    for setting, call in found:
        default, meaning, *options = (ast.literal_eval(argument) for argument in call.args)
        rows.append((f"`{setting}`", value(default) or "(to be given)", meaning + (
            f"; one of {', '.join(options[0])}" if options else "")))  # fmt: skip
    return rows


def _services(name: str) -> str:
    found = [
        call.args[0].value for _, call in _calls(name, "offer") if isinstance(call.args[0], ast.Constant)
    ]
    if not found:
        return ""
    return "\n## Services\n\n" + table(
        ("service", "type"), [(f"`{one}`", "`std_srvs/Trigger`") for one in found]
    )


def _calls(module: str, function: str) -> Iterator[tuple[str, ast.Call]]:
    """Yield (name it is given to, call) of a function's calls in a node's module."""
    tree = ast.parse((NODES / f"{module}.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        pairs = []
        if isinstance(node, ast.Assign):
            pairs = [(getattr(node.targets[0], "id", ""), node.value)]
        elif isinstance(node, ast.Dict):
            pairs = [(getattr(k, "value", ""), v) for k, v in zip(node.keys, node.values, strict=True)]
        elif isinstance(node, ast.Expr):
            pairs = [("", node.value)]
        for given, call in pairs:
            if (
                isinstance(call, ast.Call)
                and getattr(call.func, "id", getattr(call.func, "attr", "")) == function
            ):
                yield given, call


def _module_words(name: str) -> str:
    return first_sentence(_module_docstring(name))


def _module_docstring(name: str) -> str:
    words = ast.get_docstring(ast.parse((NODES / f"{name}.py").read_text(encoding="utf-8")))
    words = words.removeprefix("Node: ")
    return words[0].upper() + words[1:]
