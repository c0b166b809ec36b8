# SPDX-License-Identifier: Apache-2.0
"""What a run needs to start its nodes: commands, parameter files, environment. Imports no ROS."""

from __future__ import annotations

import errno
import os
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pam_orthosis.bag.topics import PLANT, RECORDER
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, config_folder
from pam_orthosis.nodes.layout import LAYOUT, NodeSpec

COMPOSED = "composed"
DOMAINS = range(102)  # higher ids use ports that the system hands out to anybody
PROFILE = "loopback.xml"


class Mode(NamedTuple):
    """How a run is made: one process or many, by the wall clock or in lockstep, emulated or real leg."""

    composed: bool = False
    realtime: bool = False
    with_plant: bool = True


def commands(
    work: Path, parameters: Parameters, bag: Path, scenario: str, mode: Mode
) -> dict[str, list[str]]:
    """Write a parameter file for each node into `work`; return process name -> command line.

    A node's file holds its own section, and in it the branches of the tree that it may know.
    """
    files = {}
    specs = [spec for spec in LAYOUT.values() if mode.with_plant or spec.name != PLANT]
    for spec in specs:
        extra = {"realtime": mode.realtime, "with_plant": mode.with_plant}
        if spec.name == RECORDER:
            extra |= {"directory": str(bag), "scenario_name": scenario}
        files[spec.name] = work / f"{spec.name}.yaml"
        files[spec.name].write_text(_section(spec, parameters, extra))
    if mode.composed:
        return {COMPOSED: _command(COMPOSED, *files.values())}
    return {
        spec.name: [*_command(spec.executable, files[spec.name]), "-r", f"__node:={spec.name}"]
        for spec in specs
    }


def environment(work: Path, domain: int) -> dict[str, str]:
    """Return the environment of the nodes: this host only, own domain, logs in `work`."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",  # the profile keeps it on the loopback device
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(config_folder() / PROFILE),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_LOG_DIR": str(work / "ros"),
    }


def open_environment(work: Path) -> dict[str, str]:
    """Return the environment of nodes that others shall find: ROS settings as they are, logs in `work`."""
    return {**os.environ, "ROS_LOG_DIR": str(work / "ros")}


@contextmanager
def free_domain() -> Iterator[int]:
    """Claim a ROS domain id that no other run and no other ROS program on this host uses.

    Raises:
        OrthosisError: all are taken.
    """
    first = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[first:], *DOMAINS[:first]]:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
            if _bound(claim, f"\0pam_orthosis/domain/{domain}") and not _in_use(domain):
                yield domain
                return
    raise OrthosisError("no free ROS domain id on this host; end other ROS programs")


def _section(spec: NodeSpec, parameters: Parameters, extra: Mapping[str, Any]) -> str:
    values = {**parameters.only(*spec.branches).flat(), **extra}
    if spec.muscle:
        values["muscle"] = spec.muscle
    return yaml.safe_dump({spec.name: {"ros__parameters": values}}, sort_keys=False)


def _command(executable: str, *files: Path) -> list[str]:
    command = [sys.executable, "-m", f"pam_orthosis.nodes.{executable}", "--ros-args"]
    for file in files:
        command += ["--params-file", str(file)]
    return command


def _in_use(domain: int) -> bool:
    """Whether a participant of any DDS program has the discovery port of a domain."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return not _bound(probe, ("", 7400 + 250 * domain))


def _bound(claim: socket.socket, address: Any) -> bool:
    try:
        claim.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return False
        raise
    return True
