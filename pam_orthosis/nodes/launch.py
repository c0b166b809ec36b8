# SPDX-License-Identifier: Apache-2.0
"""What a run needs to start its nodes: commands, parameter files, environment. Imports no ROS."""

from __future__ import annotations

import errno
import json
import os
import socket
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from pam_orthosis.bag.topics import PLANT, RECORDER, SAFETY, Topics, resolve
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.device import parameters_of
from pam_orthosis.model.parameters import Parameters, config_folder
from pam_orthosis.nodes.layout import EVERYTHING, SHOWN, VIEWER, NodeSpec, layout

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

COMPOSED = "composed"
PLAYER, REPLAYED = "bag_player", "replayed"
MODE_SETTINGS = ("machine_file", "realtime", "with_plant", "replay", "leg")
DOMAINS = range(102)  # higher ids use ports that the system hands out to anybody
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and of each: the DDS wire protocol
UDP_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
PROFILE = "loopback.xml"
# variables that send discovery elsewhere than the profile
ELSEWHERE = ("ROS_DISCOVERY_SERVER", "ROS_SUPER_CLIENT", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")


class Mode(NamedTuple):
    """How a run is made: one process a leg or many, by the wall clock or in lockstep, emulated or real leg.

    `legs`: namespace -> the parameters in which the leg differs, or another machine with its parameters;
    none: one leg without a namespace. `one_plant`: one node emulates all of them.
    """

    composed: bool = False
    realtime: bool = False
    with_plant: bool = True
    legs: Mapping[str, Mapping[str, Any]] = {}
    one_plant: bool = False


def commands(
    work: Path, parameters: Parameters, bag: Path, scenario: str, mode: Mode
) -> dict[str, list[str]]:
    """Write a parameter file for each node into `work`; return process name -> command line.

    A node's file holds its own section, and in it what differs from `config/` in the branches of the tree
    that it may know. Several legs are so many groups of the same nodes, each in its namespace, and one
    recorder outside them.
    """
    common = {**_of_machine(work, parameters.declared), "realtime": mode.realtime}
    common |= {"with_plant": mode.with_plant, "replay": False, "leg": ""}
    together = mode.composed and (mode.one_plant or not mode.legs)
    recorder = {"directory": as_parameter(bag), "scenario_name": scenario, "aside": together}
    if not mode.legs:
        specs = _specs(parameters, set() if mode.with_plant else {PLANT})
        return _Group(work, parameters, specs, "", common | recorder).commands(mode.composed)
    common["legs"] = json.dumps(mode.legs)
    alone = {RECORDER} | ({PLANT} if mode.one_plant or not mode.with_plant else set())
    serving = [one for one in _specs(parameters, set() if mode.one_plant else {PLANT}) if one.name in alone]
    groups = [_Group(work, parameters, [one], "", common | recorder) for one in serving]
    groups += _groups_of_legs(work, parameters, mode.legs, alone, common)
    if together:
        return {COMPOSED: _in_one_process(groups)}
    made = [group.commands(mode.composed and bool(group.leg)) for group in groups]
    return {name: command for commands in made for name, command in commands.items()}


def _groups_of_legs(
    work: Path,
    parameters: Parameters,
    legs: Mapping[str, Mapping[str, Any]],
    alone: Collection[str],
    common: Mapping[str, Any],
) -> Iterator[_Group]:
    for number, (leg, differences) in enumerate(legs.items()):
        own = parameters_of(differences, parameters)
        own_clock = ["-r", f"/clock:=/{leg}/clock"] if number else []
        settings = {**common, **_of_machine(work, own.declared), "leg": leg, "legs": ""}
        yield _Group(work, own, _specs(own, alone), leg, settings, own_clock)


def _specs(parameters: Parameters, without: Collection[str]) -> list[NodeSpec]:
    """Return the nodes of a machine's graph but for some, and for the safety monitor if it is off."""
    absent = {*without, *(() if parameters.control.limits.enabled else (SAFETY,))}
    return [spec for spec in layout(Topics(parameters.declared)).values() if spec.name not in absent]


def as_parameter(path: Path) -> str:
    """Return a path as a parameter of a node; OrthosisError if its name is no text."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise OrthosisError(
            f"{str(path)!a} is not UTF-8, and parameters of ROS nodes must be; choose another name"
        ) from None
    return str(path)


def replay_commands(
    work: Path, parameters: Parameters, nodes: Sequence[str], player: Mapping[str, Any], leg: str = ""
) -> dict[str, list[str]]:
    """Return the command lines of nodes whose answers go to `replayed/`, and of the player with its settings.

    Parameter files are written into `work`. `leg` is the nodes' leg if it was one of several.
    """
    topics = Topics(parameters.declared)
    common = {**_of_machine(work, parameters.declared), "realtime": False}
    common |= {"with_plant": True, "replay": True, "leg": leg}
    spec = NodeSpec(PLAYER, PLAYER, EVERYTHING)
    settings = {**common, **player, "nodes": ",".join(nodes)}
    group = _Group(work, parameters, [spec], "", settings).commands(False)
    for node in nodes:
        spec, remaps = layout(topics)[node], _aside(topics, node)
        group |= _Group(work, parameters, [spec], "", common, remaps).commands(False)
    return group


def view_command(work: Path, parameters: Parameters, legs: Iterable[str]) -> list[str]:
    """Return the command line of the live view of these legs; its parameter file is written into `work`."""
    settings = _of_machine(work, parameters.declared) | {"legs": ",".join(legs)}
    spec = NodeSpec(VIEWER, VIEWER, SHOWN)
    return _Group(work, parameters, [spec], "", settings).commands(False)[VIEWER]


def conductor_command(programme: Path) -> list[str]:
    """Return the command line of what leads a session by a programme."""
    return [*_command("session_conductor", [str(programme.resolve())], []), "--log-level", "error"]


def paced(commands: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    """Return command lines of a run in which the plant is never ahead of the wall clock."""
    return {name: [*command, "-p", f"{PLANT}:paced:=true"] for name, command in commands.items()}


def _of_machine(work: Path, machine: Machine) -> dict[str, str]:
    """Write the file of a machine of a user's into `work` for the nodes; return their setting of it."""
    if not machine.text:
        return {"machine_file": ""}
    file = work / f"{machine.name}.yaml"
    file.write_text(machine.text, encoding="utf-8")
    return {"machine_file": str(file)}


def _aside(topics: Topics, node: str) -> list[str]:
    """Return the remappings that put a node's answers beside those of the bag."""
    answers = [t.name for t in topics.all if t.rate == "step" and node in t.producers]
    pairs = [f"{name}:={'/' * name.startswith('/')}{REPLAYED}/{name.lstrip('/')}" for name in answers]
    return [word for pair in pairs for word in ("-r", pair)]


@dataclass(frozen=True)
class _Group:
    """Nodes in one namespace: their parameter files and command lines."""

    work: Path
    parameters: Parameters
    specs: Sequence[NodeSpec]
    leg: str
    settings: Mapping[str, Any]
    remaps: Sequence[str] = ()

    def commands(self, composed: bool) -> dict[str, list[str]]:
        """Return the command lines by the names of their processes."""
        files = self.files()
        if composed:
            names = [spec.name for spec in self.specs]
            command = _command(COMPOSED, names, files.values())
            return {self._full(COMPOSED): [*command, *self._place()]}
        return {
            full: [
                *_command(spec.executable, [], [files[full]]),
                *self._place(),
                "-r",
                f"__node:={spec.name}",
            ]
            for spec, full in zip(self.specs, files, strict=True)
        }

    def files(self) -> dict[str, Path]:
        """Write the parameter files; return them by the full names of their nodes."""
        return {self._full(spec.name): self._written(spec) for spec in self.specs}

    def _full(self, name: str) -> str:
        return f"{self.leg}/{name}" if self.leg else name

    def _written(self, spec: NodeSpec) -> Path:
        known: Iterable[str] = self.settings if spec.name in (RECORDER, PLAYER, VIEWER) else MODE_SETTINGS
        if spec.name == PLANT and self.settings.get("legs"):
            known = (*MODE_SETTINGS, "legs")
        changed = self.parameters.only(*spec.branches).changes()
        values = changed | {key: self.settings[key] for key in known}
        if spec.muscle:
            values["muscle"] = spec.muscle
        file = self.work / f"{self._full(spec.name).replace('/', '_')}.yaml"
        section = {f"/{self._full(spec.name)}": {"ros__parameters": values}}
        file.write_text(yaml.safe_dump(section, sort_keys=False))
        return file

    def _place(self) -> list[str]:
        return [*(("-r", f"__ns:=/{self.leg}") if self.leg else ()), *self.remaps]


def _in_one_process(groups: Iterable[_Group]) -> list[str]:
    """Return the command line of all nodes of these groups; each takes its namespace from its name."""
    files = {full: file for group in groups for full, file in group.files().items()}
    return _command(COMPOSED, files, files.values())


def _command(executable: str, names: Iterable[str], files: Iterable[Path]) -> list[str]:
    command = [sys.executable, "-m", "pam_orthosis.nodes.entry", executable, *names, "--ros-args"]
    for file in files:
        command += ["--params-file", str(file)]
    return command


def environment(work: Path, domain: int) -> dict[str, str]:
    """Return the environment of the nodes: this host only, own domain, logs in `work`."""
    return {
        **{name: value for name, value in os.environ.items() if name not in ELSEWHERE},
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",  # the profile keeps it on the loopback device
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(config_folder() / PROFILE),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_LOG_DIR": str(work / "ros"),
    }


def open_environment(work: Path) -> dict[str, str]:
    """Return the environment of nodes that others shall find: ROS settings as they are, logs in `work`."""
    return {**os.environ, "ROS_LOG_DIR": str(work / "ros")}


def refuse_used_domain(domain: str, environment: Mapping[str, str], mode: Mode, machine: Machine) -> None:
    """Refuse, by OrthosisError, a ROS domain in which somebody speaks on the topics of a run."""
    if not domain.isdecimal() or not _in_use(int(domain)):
        return
    names = [
        resolve(topic.name, leg)
        for leg in mode.legs or [""]
        for topic in Topics(machine).of_run(mode.realtime, mode.with_plant).values()
        if not topic.shared and (mode.with_plant or PLANT not in topic.producers)
    ]
    command = [sys.executable, "-m", "pam_orthosis.nodes.neighbours", *names]
    done = subprocess.run(command, env=dict(environment), capture_output=True, text=True, check=False)
    if found := done.stdout.strip():
        raise OrthosisError(f"ROS domain {domain} is used: {found}; end that, or set another ROS_DOMAIN_ID")


@contextmanager
def free_domain() -> Iterator[int]:
    """Claim a ROS domain id that nobody on this host uses; OrthosisError if all are taken."""
    first = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[first:], *DOMAINS[:first]]:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
            if _bound(claim, f"\0pam_orthosis/domain/{domain}") and not _in_use(domain):
                yield domain
                return
    raise OrthosisError("no free ROS domain id on this host; end other ROS programs")


def _in_use(domain: int) -> bool:
    """Whether any DDS program on this host has a port of a domain.

    Not that of discovery alone: who looks for its peers without multicast has only ports of its own.
    """
    first = FIRST_PORT + PORTS * domain
    return any(first <= port < first + PORTS for port in _udp_ports())


def _udp_ports() -> Iterator[int]:
    """Yield the UDP ports of this host that are bound."""
    for bound in UDP_TABLES:
        with suppress(OSError):  # no IPv6
            for line in bound.read_text().splitlines()[1:]:
                yield int(line.split()[1].rpartition(":")[2], 16)


def _bound(claim: socket.socket, address: Any) -> bool:
    try:
        claim.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return False
        raise
    return True
