# SPDX-License-Identifier: Apache-2.0
"""Machines read from YAML files and checked: the shipped ones, and files of users."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.components import cylinder
from pam_orthosis.model.effects import KINDS
from pam_orthosis.model.machine import ACTUATORS, ActuatorOf, Machine
from pam_orthosis.model.mechanisms import MECHANISMS
from pam_orthosis.model.mechanisms.coupled import COUPLED
from pam_orthosis.model.mechanisms.one_axis import TRANSMISSIONS
from pam_orthosis.model.rows import Field, Row
from pam_orthosis.model.specimens import BRANCH as MUSCLE
from pam_orthosis.reading import (
    check_keys,
    config_folder,
    flattened,
    from_yaml,
    mapping,
    meant,
    read_text,
    shown,
)  # fmt: skip

TOP = (
    "name", "meaning", "mechanism", "actuators", "sensor", "start", "effects", "branch", "coupled",
    "experiments", "takes", "values",
)  # fmt: skip
REQUIRED = "mechanism", "actuators", "sensor"
OF_ACTUATOR = ("kind", "parameters", "transmission", "parallel", "sizes")
NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
OF_MACHINE = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,59}")
TAKEN = ("mechanism", "sensor", "truth")  # branches of parameters, and the namespace of what only is recorded
MOST_ACTUATORS = 8
BRANCHES = ("effects", "rig.effects")
OWN = "machine"  # branch of the parameters that a file gives itself
INLINE: Mapping[str, Sequence[Field]] = {"cylinder": cylinder.FIELDS}
Names: TypeAlias = Sequence[str]
EFFECTS = tuple(effect.kind for effect in KINDS)


class _File:
    """A file of a machine while it is read: its rows, and refusals that name it."""

    def __init__(self, text: str, name: str, where: str):
        self.name, self.where = name, where
        self.rows: list[Row] = []
        self.top = self.mapping(from_yaml(text, where), "a machine")
        self.known(self.top, TOP, "a machine")

    def refusal(self, words: str) -> OrthosisError:
        return OrthosisError(f"{self.where}: {words}")

    def mapping(self, node: Any, where: str) -> dict[str, Any]:
        return mapping(node, f"{self.where}: {where}")

    def known(self, node: Collection[str], names: Collection[str], where: str) -> None:
        check_keys(node, names, f"{self.where}: {where}")

    def one_of(self, node: Mapping[str, Any], key: str, names: Collection[str], where: str) -> str:
        if key not in node:
            near = next((f", but {shown(one)}" for one in node if meant(one, [key])), "")
            raise self.refusal(f"{where} has no {key}{near}: give {key}, one of {', '.join(names)}")
        value = node[key]
        if not isinstance(value, str) or value not in names:
            raise self.refusal(f"{key} of {where} is one of {', '.join(names)}, not {shown(value)}")
        return value

    def text(self, node: Mapping[str, Any], key: str, default: str) -> str:
        value = node.get(key, default)
        if not isinstance(value, str) or not value:
            raise self.refusal(f"{key} is a text, not {shown(value)}")
        return value

    def values(self) -> dict[str, Any]:
        """Return the values of parameters by dotted key."""
        with naming(f"{self.where}: values"):
            return flattened(self.mapping(self.top.get("values", {}), "values"))

    def section(
        self, node: Mapping[str, Any], fields: Sequence[Field], branch: str, where: str, others: Names = ()
    ) -> str:
        """Take the values of a part, which may have other keys elsewhere, as rows; return their branch."""
        self.known(node, (*others, *(one.name for one in fields)), where)
        for one in fields:
            value = node.get(one.name, one.default)
            if value is None:
                raise self.refusal(f"{where} has no {one.name}: {one.meaning}, in {one.unit}")
            with naming(self.where):
                self.rows.append(one.row(branch, value, f"the file of {self.name}"))
        return branch


def read_machine(path: Path) -> Machine:
    """Return the machine that a file declares; OrthosisError for a missing, unknown or unusable entry."""
    return machine_from(read_text(path), path.stem, str(path))


def machine_from(text: str, name: str, where: str) -> Machine:
    """Return the machine that a text declares, of this name if it gives none; refusals begin with `where`.

    Raises:
        OrthosisError: an entry that is missing, unknown or unusable.
    """
    file = _File(text, name, where)
    top = file.top
    if absent := [key for key in REQUIRED if key not in top]:
        raise file.refusal(f"a machine has a {absent[0]}, which is missing here")
    kind, parameters = _mechanism(file)
    actuators, chosen = _actuators(file, kind), _effects(file)
    experiments = top.get("experiments", False)
    if not isinstance(experiments, bool):
        raise file.refusal(f"experiments is true or false, not {shown(experiments)}")
    takes = file.mapping(top.get("takes", {}), "takes")
    machine = Machine(
        name=_name(file),
        meaning=file.text(top, "meaning", name),
        kind=kind,
        parameters=parameters,
        actuators=actuators,
        sensor=_sensor(file, MECHANISMS[kind].coordinate.name, MECHANISMS[kind].coordinate.unit),
        start=file.text(top, "start", f"{parameters}.start") if kind != "carriage" else "",
        effects=chosen,
        branch=file.one_of({"branch": BRANCHES[0], **top}, "branch", BRANCHES, "a machine"),
        coupled=_coupled(file, kind),
        experiments=experiments,
        takes={key: file.text(takes, key, "") for key in takes},
        rows=tuple(file.rows),
        values=file.values(),
        text=text,
    )
    if absent := [name for name in chosen if not machine.has(name)]:
        raise file.refusal(f"a {kind} of these actuators cannot have the effect {absent[0]}")
    return machine


def check_name(name: str, what: str) -> None:
    """Refuse, by OrthosisError, what cannot name a namespace of topics and a branch of parameters."""
    if not NAME.fullmatch(name) or name in TAKEN:
        told = f"give one of small letters, digits, underscores, but not {', '.join(TAKEN)}"
        raise OrthosisError(f"{what} cannot be called {shown(name)}; {told}")


def _name(file: _File) -> str:
    """Return the machine's name, which its joint has on topics and in frames, where actuators have theirs."""
    name = file.text(file.top, "name", file.name)
    if not OF_MACHINE.fullmatch(name) or name in file.top["actuators"]:
        raise file.refusal(
            f"{shown(name)} cannot be the machine's name: give another than its actuators have, of letters,"
            " digits, hyphens, underscores"
        )
    return name


def _mechanism(file: _File) -> tuple[str, str]:
    node = file.mapping(file.top.get("mechanism"), "mechanism")
    kind = file.one_of(node, "kind", MECHANISMS, "the mechanism")
    rest = {key: value for key, value in node.items() if key != "kind"}
    fields = MECHANISMS[kind].fields
    if not fields:
        file.known(node, ("kind", "parameters"), f"a {kind}")
        return kind, file.text(rest, "parameters", "")
    branch = file.section(rest, fields, f"{OWN}.mechanism", f"the mechanism ({kind})", ("kind",))
    values: dict[str, Any] = {row.key.rsplit(".", 1)[1]: row.value for row in file.rows}
    if (
        not values["minimum"] <= values["start"] <= values["maximum"]
        or values["minimum"] == values["maximum"]
    ):
        limits = ", ".join(f"{key} = {values[key]}" for key in ("minimum", "start", "maximum"))
        raise file.refusal(f"the mechanism's start lies between its stops, not so: {limits}")
    return kind, branch


def _coupled(file: _File, kind: str) -> str:
    coupled = file.one_of({"coupled": "", **file.top}, "coupled", ("", *COUPLED), "a machine")
    if coupled and kind not in COUPLED[coupled].joints:
        raise file.refusal(f"a {kind} is no joint of a {coupled}")
    return coupled


def _effects(file: _File) -> tuple[str, ...]:
    chosen = file.top.get("effects", [])
    if not isinstance(chosen, list) or not all(isinstance(name, str) for name in chosen):
        raise file.refusal("effects is a list of names")
    file.known(chosen, EFFECTS, "the catalogue of effects")
    return tuple(chosen)


def _actuators(file: _File, mechanism: str) -> tuple[ActuatorOf, ...]:
    declared = file.mapping(file.top.get("actuators"), "actuators")
    if not 1 <= len(declared) <= MOST_ACTUATORS:
        raise file.refusal(f"a machine has 1 to {MOST_ACTUATORS} actuators, not {len(declared)}")
    actuators = tuple(_actuator(file, name, node, mechanism) for name, node in declared.items())
    if not MECHANISMS[mechanism].fields and len(actuators) != 2:
        raise file.refusal(f"a {mechanism} has two actuators, not {len(actuators)}")
    return actuators


def _actuator(file: _File, name: str, node: Any, mechanism: str) -> ActuatorOf:
    where = f"actuator {name}"
    check_name(name, f"{file.where}: an actuator")
    node = file.mapping(node, where)
    kind = file.one_of(node, "kind", ACTUATORS, where)
    inline = {key: value for key, value in node.items() if key not in OF_ACTUATOR}
    if "parameters" in node or kind not in INLINE:
        file.known(inline, OF_ACTUATOR, where)
        if not node.get("parameters"):
            raise file.refusal(f"{where} has no parameters: give the branch of its values, as muscle.dmsp_20")
        branch = file.text(node, "parameters", "")
        if kind == "muscle" and not branch.startswith(MUSCLE):
            raise file.refusal(f"{where}: its parameters are a branch as {MUSCLE}dmsp_20, not {branch}")
    else:
        branch = file.section(inline, INLINE[kind], f"{OWN}.{name}", where, OF_ACTUATOR)
    own = bool(MECHANISMS[mechanism].fields)
    if own != ("transmission" in node):
        raise file.refusal(
            f"{where}: a {mechanism} {'needs a transmission' if own else 'has its own transmission'}"
        )
    sizes = _sizes(file, node.get("sizes", {}), where)
    parallel = node.get("parallel", 1)
    if type(parallel) is not int or not 1 <= parallel <= MOST_ACTUATORS:
        raise file.refusal(
            f"parallel of {where} is a number from 1 to {MOST_ACTUATORS}, not {shown(parallel)}"
        )
    return ActuatorOf(
        name, kind, branch, _transmission(file, name, node, mechanism) if own else "", parallel, sizes
    )


def _sizes(file: _File, node: Any, where: str) -> dict[str, float]:
    sizes = file.mapping(node, f"sizes of {where}")
    file.known(sizes, EFFECTS, "the catalogue of effects")
    largest_size = 1000.0  # times the bounds of an effect: beyond it another effect is meant
    for name, value in sizes.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= largest_size:
            raise file.refusal(
                f"the size of {name} of {where} is a number up to {largest_size:g}, not {shown(value)}"
            )
    return sizes


def _transmission(file: _File, name: str, node: Mapping[str, Any], mechanism: str) -> str:
    where = f"transmission of actuator {name}"
    given = file.mapping(node["transmission"], where)
    ways = [way for way, fields in TRANSMISSIONS.items() if fields[0].name in given]
    if len(ways) != 1:
        firsts = ", ".join(fields[0].name for fields in TRANSMISSIONS.values())
        raise file.refusal(f"{where} is given by one of {firsts}, not {shown(list(given))}")
    branch = file.section(given, TRANSMISSIONS[ways[0]], f"{OWN}.{name}.transmission", where)
    if ways[0] == "table":
        farthest = next(one.maximum for one in MECHANISMS[mechanism].fields if one.name == "maximum")
        _check_table(file, given, where, farthest)
    return branch


def _check_table(file: _File, given: Mapping[str, list[float]], where: str, farthest: float) -> None:
    places, values = given["coordinates"], given["contractions"]
    if not isinstance(places, list) or not isinstance(values, list) or len(places) != len(values):
        raise file.refusal(f"{where}: coordinates and contractions are lists of the same length")
    if not 3 <= len(places) <= 40:
        raise file.refusal(f"{where}: coordinates are 3 to 40 numbers, not {len(places)}")
    if max(map(abs, places)) > farthest:
        raise file.refusal(f"{where}: coordinates go beyond {farthest:g}; check their unit")


def _sensor(file: _File, coordinate: str, unit: str) -> str:
    node = file.top.get("sensor")
    if isinstance(node, str):
        return node
    fields = [
        Field(f"{coordinate}_noise", unit, 0.0, 1.0, "standard deviation of the sensor's noise"),
        Field(f"{coordinate}_resolution", unit, 0.0, 1.0, "step of the sensor", 0.0),
    ]
    given = file.mapping(node, "sensor")
    file.known(given, ("noise", "resolution"), "a sensor")
    named = {f"{coordinate}_{key}": value for key, value in given.items()}
    return f"{file.section(named, fields, f'{OWN}.sensor', 'the sensor')}.{coordinate}"


def _shipped(name: str) -> Machine:
    return replace(read_machine(config_folder() / "machines" / f"{name}.yaml"), text="")


def shipped_machines() -> list[str]:
    """Return the names of the shipped machines that controllers move."""
    names = sorted(path.stem for path in (config_folder() / "machines").glob("*.yaml"))
    return [name for name in names if name != RIG.name]


def shipped_machine(name: str) -> Machine:
    """Return a shipped machine, whatever stands in the present folder."""
    return KNEE if name == KNEE.name else read_machine(config_folder() / "machines" / f"{name}.yaml")


def machine_named(name: Path | None = None) -> Machine:
    """Return the machine of a file or, where there is none, the shipped one of this name; none: the knee.

    A folder, perhaps of recordings, that is called as a shipped one stands in nobody's way.

    Raises:
        OrthosisError: neither is there, it is that of a device, or the file is unusable.
    """
    shipped = name is None or str(name) in shipped_machines()
    if name is not None and name.exists() and not (shipped and name.is_dir()):
        return read_machine(name)
    if shipped:
        return shipped_machine(str(name or KNEE.name))
    if str(name) == RIG.name:
        raise OrthosisError(
            "rig: the test rig has verbs of its own, `rig` and `identify`; give ankle, shoe or a file"
        )
    devices = sorted(path.stem for path in (config_folder() / "devices").glob("*.yaml"))
    if str(name) in devices:
        raise OrthosisError(f"{name} is a device of several machines, for `run`; give one of its machines")
    names = f"{', '.join(shipped_machines())}, for `run` also {', '.join(devices)}"
    raise OrthosisError(f"no machine {name}: there is no such file; those that come with it: {names}")


KNEE, RIG = _shipped("knee"), _shipped("rig")
