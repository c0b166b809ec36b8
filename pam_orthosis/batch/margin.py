# SPDX-License-Identifier: Apache-2.0
"""Measures all margins: one perturbation in one direction is a unit of work.

python -m pam_orthosis.batch.margin '{"control.position.c1": 30.0}' friction more NOMINAL_ERROR_RAD
"""

import json
import math
import sys
from collections.abc import Sequence
from concurrent.futures import as_completed
from itertools import product
from typing import Any

from pam_orthosis.batch.unit import Unit, local, work
from pam_orthosis.control import margin
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.model.machines import machine_from
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.progress import Progress, silent

DIRECTIONS = ("more", "less")
LIMITS = ("doubled", "lost")


def measure(parameters: Parameters, workers: int, progress: Progress = silent) -> dict[str, Any]:
    """Return the margins as plain data: `margin.json` holds it.

    Raises:
        OrthosisError: the machine is lost on the hardware as it is, or the runs end before it moves.
        RunFailed: a unit gave no answer.
    """
    _refuse_short(parameters)
    progress("the hardware as it is")
    nominal = margin.maximum_error(parameters)
    if math.isinf(nominal):
        raise OrthosisError(
            f"the {parameters.declared.name} is lost on the hardware as it is: there is no margin;"
            " check gains and model"
        )
    present = margin.perturbations(parameters)
    unit = parameters.declared.coordinate.shown_unit
    shown = parameters.declared.coordinate.shown_factor
    units = [_unit(parameters, name, direction, nominal) for name, direction in product(present, DIRECTIONS)]
    rows = _worked(units, workers, progress)
    doubled, lost = margin.thresholds(parameters, nominal)
    return {
        "duration_s": parameters.scenario.duration,
        "seed": parameters.scenario.seed,
        "machine": parameters.declared.name,
        "error_unit": unit,
        f"max_abs_error_{unit}": shown * nominal,
        f"doubled_{unit}": shown * doubled,
        f"lost_{unit}": shown * lost,
        "margins": [rows[unit.name] for unit in units],
        "not_there": [name for name in margin.NAMES if name not in present],
    }


def _refuse_short(parameters: Parameters) -> None:
    scenario = parameters.scenario
    begins = scenario.start_hold + scenario.start_ramp
    if scenario.duration < begins:
        raise OrthosisError(
            f"scenario.duration = {scenario.duration:g} s is too short: the motion begins after {begins:g} s;"
            " give a cycle more than that, or the margins are those at rest"
        )


def _unit(parameters: Parameters, name: str, direction: str, nominal: float) -> Unit:
    machine, changes = parameters.declared, json.dumps(parameters.changes())
    own = (machine.name, machine.text) if machine.text else ()
    return Unit(f"{name}, {direction}", __name__, (changes, name, direction, repr(nominal), *own))


def _worked(units: Sequence[Unit], workers: int, progress: Progress) -> dict[str, dict[str, Any]]:
    """Return the answer of each unit by its name."""
    rows: dict[str, dict[str, Any]] = {}
    with local(workers) as (executor, _):
        waiting = {executor.submit(work, unit): unit for unit in units}
        progress("margins", 0, len(units))
        for future in as_completed(waiting):
            unit, answer = waiting[future], future.result()
            if answer.result is None:
                raise RunFailed(f"{unit.name}: {answer.complaint}")
            rows[unit.name] = dict(answer.result)
            progress("margins", len(rows), len(units))
    return rows


def one(parameters: Parameters, name: str, direction: str, nominal: float) -> dict[str, Any]:
    """Return the margins against one perturbation in one direction; `nominal`: maximum error without it."""
    coordinate = parameters.declared.coordinate
    changed = margin.perturbations(parameters)[name]
    ladder = changed.ladder(direction)

    def error(value: float) -> float:
        if value == changed.nominal:
            return nominal
        return margin.maximum_error(parameters.changed(changed.overrides(value)))

    found, known = margin.limits(error, ladder, margin.thresholds(parameters, nominal))
    return {
        "perturbation": name,
        "meaning": changed.meaning,
        "unit": changed.unit,
        "direction": direction,
        "nominal": changed.nominal,
        "end": ladder[-1],
        **{key: limit._asdict() for key, limit in zip(LIMITS, found, strict=True)},
        "runs": [
            {
                "value": value,
                f"max_abs_error_{coordinate.shown_unit}": (
                    coordinate.shown_factor * known[value] if known[value] < math.inf else None
                ),
            }
            for value in sorted(known)
        ],
    }


def main(arguments: Sequence[str]) -> int:
    """Measure one unit's margins and print them; return 0, or 2 if these parameters cannot run."""
    overrides, name, direction, nominal, *own = arguments
    try:
        machine = machine_from(own[1], own[0], own[0]) if own else None
        result = one(load(json.loads(overrides), machine), name, direction, float(nominal))
    except OrthosisError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
