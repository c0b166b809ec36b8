# SPDX-License-Identifier: Apache-2.0
"""Machines, their parameters, and runs of them: in the closed loop, or driven by given voltages."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.control.load import check_load
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import OrthosisError
from pam_orthosis.library import checked_arguments as given
from pam_orthosis.library.options import arguments_named
from pam_orthosis.library.run import Array, Run, Runs
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.study import Study
from pam_orthosis.model.truth import as_modelled, with_nominal

DRIVEN = "given voltages"
EFFECTS = "plant.effects."


@arguments_named()
def machine(path: str | Path | None = None) -> Machine:
    """Return the machine of a [file](machine-file.md), or the knee.

    Raises:
        OrthosisError: the file is unusable.
    """
    return machine_named(given.file(path, "path"))


@arguments_named()
def parameters(
    scenario: str = "default",
    changes: Mapping[str, Any] | None = None,
    machine: Machine | str | Path | None = None,
    exact: bool = False,
) -> Parameters:
    """Return the parameters of a machine in a [scenario](scenarios.md).

    Args:
        scenario: what the machine does.
        changes: dotted key -> value, such as `{"control.position.c1": 30.0}`.
        machine: its YAML file, or what `machine(path)` returned; the knee if None.
        exact: the emulated hardware is the nominal model, but for the scenario and `changes`. Otherwise it
            has effects of its own, which `gap` finds beside one that is hidden.

    Raises:
        OrthosisError: an unknown scenario or key, or an unusable value.
    """
    declared, own = given.machine(machine), given.changes(changes or {}, "changes")
    shipped = as_modelled(load({}, declared)) if exact else {}
    made = load(shipped | scenario_overrides(given.text(scenario, "scenario")) | own, declared)
    for effect in {key.rpartition(".")[0] for key in own if key.startswith(EFFECTS)}:
        if exact and not made.flat().get(f"{effect}.enabled", True):
            raise OrthosisError(f"{effect} is off in exact hardware; give {effect}.enabled: True too")
    return made


@overload
def simulate(
    parameters: Parameters, *, voltages: ArrayLike | None = None, model: Mapping[str, Any] | None = None
) -> Run: ...


@overload
def simulate(
    parameters: Parameters,
    cases: Mapping[str, ArrayLike],
    voltages: ArrayLike | None = None,
    model: Mapping[str, Any] | None = None,
) -> Runs: ...


@arguments_named()
def simulate(
    parameters: Parameters,
    cases: Mapping[str, ArrayLike] | None = None,
    voltages: ArrayLike | None = None,
    model: Mapping[str, Any] | None = None,
) -> Run | Runs:
    """Simulate a machine with its cascade of controllers, or driven by given valve voltages.

    The run lasts `scenario.duration`, or as long as there are voltages.

    Args:
        parameters: of machine, controllers and scenario.
        cases: dotted key -> its values, (cases,): a run for each.
        voltages: (n, actuators) V, each held for a control period; then no controller takes part, and the
            states come out free of noise. Many cases of the knee are advanced in vector registers.
        model: dotted key -> value that the controllers' nominal model has instead, such as `Gap.changes()`;
            the emulated hardware stays. A change of `parameters` changes both.

    Raises:
        OrthosisError: an unusable value or voltage, cases of different lengths, or the machine cannot be
            held at its start.
    """
    if not isinstance(parameters, Parameters):
        raise OrthosisError(f"simulate: give parameters, such as po.parameters(), not {parameters!r}")
    parameters = with_nominal(parameters, given.changes(model, "model")) if model else parameters
    driving = None if voltages is None else _checked(voltages, parameters)
    if cases is None:
        return _simulated(parameters, driving)
    columns = _columns(given.changes(cases, "cases"))
    every = [parameters.changed(one) for one in _rows(columns)]
    if driving is None or parameters.declared is not machine_named() or len(every) == 1:
        return Runs([_simulated(one, driving) for one in every], columns)
    return Runs(_together(parameters, every, columns, driving), columns)


def _simulated(parameters: Parameters, voltages: Array | None) -> Run:
    return _followed(parameters) if voltages is None else _driven(parameters, voltages)


def _columns(cases: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Return the values of each key, (cases,); OrthosisError if they are not as many, or none."""
    try:
        columns = {key: np.atleast_1d(np.asarray(values)) for key, values in cases.items()}
    except ValueError:  # rows of different lengths
        columns = {}
    if len(lengths := {len(column) for column in columns.values()}) != 1 or lengths == {0}:
        raise OrthosisError("cases: give each key as many values as the others, one or more")
    return columns


def _rows(columns: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for values in zip(*(column.tolist() for column in columns.values()), strict=True):
        yield dict(zip(columns, values, strict=True))


def _checked(voltages: ArrayLike, parameters: Parameters) -> Array:
    rows, names = given.numbers(voltages, "voltages"), parameters.declared.names
    if rows.ndim != 2 or rows.shape[1] != len(names) or not len(rows) or not np.isfinite(rows).all():
        raise OrthosisError(f"voltages: give finite numbers, a row a control period: {', '.join(names)}")
    return rows


def _stamps(parameters: Parameters, samples: int) -> Any:
    return np.arange(samples) * round(parameters.scenario.control_period * SECOND_NS)


def _followed(parameters: Parameters) -> Run:
    check_load(parameters)
    settings = parameters.scenario
    steps = round(settings.duration / settings.control_period)
    result = ClosedLoop(parameters, settings.seed).run(steps)
    del result["time"]
    return Run(parameters, "simulated", _stamps(parameters, steps), result)


def _driven(parameters: Parameters, voltages: Array) -> Run:
    plant, states = Plant(parameters), []
    for row in voltages.tolist():
        states.append(list(plant.signals().values()))
        plant.advance(*row)
    names = list(plant.signals())
    result = dict(zip(names, np.array(states).T, strict=True))
    return _as_run(parameters, {name: result[name] for name in parameters.declared.states}, voltages)


def _as_run(parameters: Parameters, states: Mapping[str, Array], voltages: Array) -> Run:
    names = (f"{name}_voltage" for name in parameters.declared.names)
    signals = {**states, **dict(zip(names, voltages.T, strict=True))}
    return Run(parameters, DRIVEN, _stamps(parameters, len(voltages)), signals)


def _together(
    parameters: Parameters, every: list[Parameters], columns: Mapping[str, Array], voltages: Array
) -> list[Run]:
    states = parameters.declared.states
    result = Study(parameters, list(columns), states).simulate(
        np.column_stack(list(columns.values())), voltages
    )
    return [
        _as_run(one, {name: result[name][number] for name in states}, voltages)
        for number, one in enumerate(every)
    ]
