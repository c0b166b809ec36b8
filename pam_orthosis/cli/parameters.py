# SPDX-License-Identifier: Apache-2.0
"""Which parameters a verb works with: those of scenario, machine, single values and a nominal model."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.progress import shown
from pam_orthosis.reading import from_yaml

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

DEFAULT = "default"
LEAST_PERIODS = 20  # that the hardware of a machine of one's own has to bear before a run


def add_parameter_arguments(
    parser: argparse.ArgumentParser, scenario: str, default: str | None = DEFAULT
) -> None:
    """Declare scenario, machine and single values; `scenario` is the help on the first."""
    parser.add_argument("--scenario", default=default, metavar="NAME", help=scenario)
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="FILE",
        help="another machine: a YAML file, ankle, shoe or, for `run`, leg and device (knee)",
    )
    meaning = "set a parameter, e.g. control.position.c1=30 (repeatable)"
    parser.add_argument("--param", action="append", default=[], metavar="KEY=VALUE", help=meaning)


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """Declare a nominal model of the controllers."""
    parser.add_argument(
        "--model", type=Path, metavar="FILE",
        help="YAML that changes the nominal model of the controllers (by `gap`, `improve`, `plan` or"
        " `identify`); the emulated hardware stays",
    )  # fmt: skip


def chosen(
    arguments: argparse.Namespace, more: Mapping[str, Any] | None = None, scenario: str = ""
) -> Parameters:
    """Return the parameters of scenario (or that of the arguments), machine and single values.

    Values of `more` give way to single ones.
    """
    own = scenario_overrides(scenario or arguments.scenario) | dict(more or {})
    return load(own | assignments(arguments.param), machine_of(arguments))


def machine_of(arguments: argparse.Namespace) -> Machine:
    """Return the machine that is given; OrthosisError for an unusable file, or a scenario of the knee."""
    from pam_orthosis.model.machines import machine_named

    machine = machine_named(arguments.machine)
    if arguments.scenario not in (None, DEFAULT) and not machine.experiments:
        problem = f"--scenario {arguments.scenario} is for the knee"
        raise OrthosisError(f"{problem}; give the machine's motion by values in {arguments.machine}")
    return machine


def check_controllable(parameters: Parameters) -> None:
    """Raise OrthosisError if there are no controllers for the machine, or it cannot do what is asked for."""
    from pam_orthosis.control.axis import Axis
    from pam_orthosis.control.load import check_load
    from pam_orthosis.control.trajectory import make_trajectory
    from pam_orthosis.model.reach import check_lengths

    check_lengths(parameters.declared, parameters)
    Axis(parameters.nominal())
    _check_beginning(parameters, make_trajectory(parameters).sample(0).position)
    check_load(parameters)
    if parameters.declared.text:  # a shipped machine is known to hold at its start
        from pam_orthosis.model.plant import Plant  # casadi takes a second to load

        plant, closed = Plant(parameters), parameters.valve.closed_voltage
        for _ in range(LEAST_PERIODS):  # one that diverges does so before anything is written
            plant.advance(*[closed] * len(plant.lines))
            plant.measure()


def _check_beginning(parameters: Parameters, begins: float) -> None:
    """Raise OrthosisError if the motion begins where a guard takes the machine for lost."""
    machine, start = parameters.declared, parameters.at(parameters.declared.start)
    if abs(begins - start) >= parameters.control.guard.tracking_error:
        unit = machine.coordinate.unit
        raise OrthosisError(
            f"the motion begins at {begins:.6g} {unit}, the {machine.name} at {machine.start} = {start:.6g}"
            f" {unit}: give --param {machine.start}={begins:.6g}"
        )


def with_model(parameters: Parameters, arguments: argparse.Namespace) -> Parameters:
    """Return the parameters with the nominal model of --model, if there is one, and the same hardware."""
    if arguments.model is None:
        return parameters
    from pam_orthosis.control.loop import ClosedLoop  # casadi takes a second to load
    from pam_orthosis.discrepancy.answer import patch
    from pam_orthosis.model.truth import with_nominal

    model, given = arguments.model, assignments(arguments.param)
    changes = patch.read_nominal(model, parameters.declared)
    if twice := [key for key in given if changes.get(key, given[key]) != given[key]]:
        raise OrthosisError(f"{twice[0]}: --param and {model} give different values; leave one of them")
    with naming(model):
        known = with_nominal(parameters, changes)
    with shown("preparing the controllers of this model"):
        ClosedLoop(known)  # leaves its machine code for the nodes, whose time to be ready is limited
    return known


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """Return parameters from texts KEY=VALUE; OrthosisError for another text or a key with two values."""
    given: dict[str, Any] = {}
    for key, value in map(_assignment, texts):
        if key in given and given[key] != value:
            raise OrthosisError(f"--param {key} is given twice, as {given[key]} and {value}; give it once")
        given[key] = value
    return given


def _assignment(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise OrthosisError(f"--param {text}: give KEY=VALUE")
    return key, _value(value)


def _value(text: str) -> Any:
    """Return a value as YAML reads it, but numbers as everybody else does."""
    for number in (int, float):  # YAML 1.1 takes 075 for 61 and 1e-4 for a text
        with suppress(ValueError):
            return number(text)
    try:
        return from_yaml(text, "--param")
    except OrthosisError:  # a text, which the row of the key refuses if it wants none
        return text
