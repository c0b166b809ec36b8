# SPDX-License-Identifier: Apache-2.0
"""The model file: overrides by dotted key, written and read by the verbs, and by the simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.unknown.description import Description, holder
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import write_text
from pam_orthosis.model.effects.described import settings, short
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import NOMINAL, Parameters, load
from pam_orthosis.reading import flattened, read_yaml

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.answer.judgement import Outcome

DESCRIBED = "described"  # verdict
HEADING = "# Model of the gap workflow: overrides by dotted key, for `--model`.\n"
OF_NOMINAL = tuple(f"{branch}." for branch in NOMINAL if branch != "scenario")
PLANNED = "scenario.plan."
SEARCH = "gap."
OF_GAP = SEARCH, "scenario.control_period"  # how recordings are to be read: nothing to a run
SUPPLY, HIGHEST = "valve.supply_pressure", "control.position.maximum_pressure"
REACH = 0.97  # of a supply pressure: what a controller asks of a muscle at most


def overrides(system: System, effects: Sequence[str], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the dotted-key overrides that switch effects on, and correct wrong parameters; nothing else."""
    changed: dict[str, Any] = {}
    for name in effects:
        if name in system.wrong:
            value, own = values[f"{name}.{VALUE}"], system.recalibrating(name)
            value = value if own is None else float(own.applied(value))
            factors = system.common.get(name, {system.wrong[name]: 1.0})
            changed |= {key: float(f"{value * nominal:.6g}") for key, nominal in factors.items()}
            continue
        changed[f"{system.branch}.{name}.enabled"] = True
        for q in system.catalogue[name].parameters:
            whole = values[f"{name}.{q.name}"] + system.already.get(f"{name}.{q.name}", 0.0)
            changed[f"{system.branch}.{name}.{q.name}"] = float(f"{whole:.6g}")
    return changed


def limits(nominal: Parameters, changed: Mapping[str, Any]) -> dict[str, float]:
    """Return the highest reference pressure where the supply turned out to be too low for the present one."""
    reach = REACH * float(changed.get(SUPPLY, nominal.at(SUPPLY)))
    if SUPPLY not in changed or reach >= changed.get(HIGHEST, nominal.at(HIGHEST)):
        return {}
    least = nominal.row(HIGHEST).minimum
    return {HIGHEST: float(f"{reach if least is None else max(least, reach):.6g}")}


def changes_of(outcome: Outcome) -> dict[str, Any]:
    """Return what a search found as overrides: named effects, right values, what it could only describe."""
    system, named = outcome.system, [one.name for one in outcome.effects]
    values = outcome.selection.final.values
    if not outcome.unknown or outcome.verdict != DESCRIBED:
        return overrides(system, named, values)
    curves: dict[str, Any] = {}
    for one in outcome.unknown.descriptions:
        if (own := of_description(system, one)) and system.changed is not None:
            values = {**values, **one.beside}
        curves |= own
    return overrides(system, named, values) | curves | dict(outcome.unknown.beside)


def of_description(system: System, one: Description) -> dict[str, Any]:
    """Return the overrides that put a curve into the nominal model; none if that cannot hold it."""
    known = holder(system, one)
    if known is None:
        return {}
    name, coordinate = known
    places, values = one.places.tolist(), one.values.tolist()
    if system.changed is None:
        own = settings(coordinate, places, values)
    elif one.is_constant:
        own = short(coordinate, [places[0], places[-1]], [one.level, one.level])
    else:  # it need not have a parameter that takes the mean
        own = short(coordinate, places, [value + one.level for value in values])
    return {f"{system.branch}.{name}.{key}": value for key, value in own.items()}


def text(changed: Mapping[str, Any]) -> str:
    """Return the text of a model file with overrides, merged over those that were given."""
    return HEADING + str(yaml.safe_dump(dict(changed), sort_keys=False))


def kept(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was given for a search without what is of a run, which verbs that run refuse in a file."""
    of_run = [key for key in given if key.startswith("scenario.") and not key.startswith((PLANNED, *OF_GAP))]
    return {key: value for key, value in given.items() if key not in of_run}


def write(path: Path, changed: Mapping[str, Any]) -> None:
    """Write a model file; OrthosisError if it exists or cannot be written."""
    write_text(path, text(changed))


def read(path: Path, machine: Machine | None = None) -> dict[str, Any]:
    """Return the overrides of a model file: dotted keys, nested sections, or rows as in `config/muscle.yaml`.

    Args:
        path: of the file.
        machine: of another file than the shipped ones, whose parameters these are.

    Raises:
        OrthosisError: missing, empty, malformed, not a mapping, an answer of `gap`, a value that its
            parameter cannot have, a row of the hardware, or one of an effect that the file does not switch.
    """
    content = _mapping(path)
    known = load(machine=machine)
    muscles = {name for name, _ in known.muscle.items()}
    # a file of `identify` has the rows of config/muscle.yaml
    content = {f"muscle.{key}" if key in muscles else key: value for key, value in content.items()}
    with naming(path):
        changed = {key: known.row(key).with_value(value).value for key, value in flattened(content).items()}
        _check_modelled(changed)
    return changed


def read_of_system(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what a model file says of a search (`gap.*`), and of a user's own system, unchecked.

    Raises:
        OrthosisError: missing, empty, malformed, not a mapping, a setting that a search cannot have.
    """
    known = load()
    with naming(path):
        content = flattened(_mapping(path))
        of_gap = {
            key: known.row(key).with_value(content.pop(key)).value
            for key in [*content]
            if key.startswith(SEARCH)
        }
    return of_gap, content


def _mapping(path: Path) -> dict[str, Any]:
    content = read_yaml(path)
    if content is None:
        raise OrthosisError(f"{path} is empty: it changes nothing; leave --model out")
    if not isinstance(content, dict):
        raise OrthosisError(f"{path} is not a mapping of parameters to values")
    if {"verdict", "closure"} <= set(content):
        raise OrthosisError(f"{path} is an answer of gap and no model; the model.yaml beside it is one")
    return content


def _check_modelled(changed: Mapping[str, Any]) -> None:
    """Refuse, by OrthosisError, what is of the hardware, or would do nothing since its effect is off."""
    for key in changed:
        if key.startswith("plant."):
            raise OrthosisError(
                f"{key} is not of the nominal model but of the hardware; `run` takes it by --param"
            )
        if "effects." in key and (switch := f"{key.rpartition('.')[0]}.enabled") not in changed:
            raise OrthosisError(f"{key} does nothing while the effect is off; give {switch}: true too")


def read_nominal(path: Path, machine: Machine | None = None) -> dict[str, Any]:
    """Return the overrides of a file that holds the controllers' nominal model, a plan included; see `read`.

    Raises:
        OrthosisError: as `read` and `nominal_of`.
    """
    return nominal_of(read(path, machine), path)


def nominal_of(given: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return what a model file has of the nominal model, without what it has for `gap`.

    Raises:
        OrthosisError: it has a parameter of the hardware or of the run.
    """
    changed = {key: value for key, value in given.items() if not key.startswith(OF_GAP)}
    for key in changed:
        if not key.startswith((*OF_NOMINAL, PLANNED)):
            raise OrthosisError(f"{path}: {key} is not of the nominal model; give it by --param")
    return changed
