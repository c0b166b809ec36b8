# SPDX-License-Identifier: Apache-2.0
"""The programme of a training session: stages of strides and pauses, read from YAML and checked."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pam_orthosis.control.legs import differences
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.reading import check_keys, mapping, read_yaml

LEGS = ("left", "right")
KEYS = ("scenario", "resume_s", *LEGS, "stages")
SETTINGS = {key: f"control.cooperation.{key}" for key in ("mode", "stiffness", "damping", "tunnel")}
OF_STAGE = ("name", "strides", "pause_s", "cycle_time_s", *SETTINGS)
MOST_STRIDES, LONGEST_PAUSE_S, LONGEST_S = 2000, 1800.0, 7200.0


class Stage(NamedTuple):
    """Strides at a cadence in a mode, or a pause.

    Attributes:
        name: in the report.
        strides: how many; 0: it is a pause.
        pause: how long the legs rest when they have come to rest, s.
        changes: of the parameters from here on: cadence and cooperation.
    """

    name: str
    strides: int
    pause: float
    changes: Mapping[str, Any]


class Programme(NamedTuple):
    """A session: parameters of each leg by its namespace, time until it goes on after a trip, s, stages."""

    legs: Mapping[str, Parameters]
    resume: float
    stages: tuple[Stage, ...]
    scenario: str


def read_programme(path: Path) -> Programme:
    """Return the programme of a YAML file; OrthosisError if it is unusable or cannot be read."""
    top = mapping(read_yaml(path), str(path))
    check_keys(top, KEYS, f"{path}: a programme")
    scenario = top.get("scenario", "session")
    resume_s = 10.0  # after a trip, until the therapist has looked and the training goes on
    with naming(path):
        shared = load(scenario_overrides(str(scenario)))
        if shared.scenario.trajectory != "gait":
            raise OrthosisError(f"scenario {scenario} is no gait")
        own = differences(shared)
        legs = {leg: shared.changed(own[leg] | _of_leg(top.get(leg, {}), leg)) for leg in LEGS}
        stages = _stages(top.get("stages"), shared)
        return Programme(legs, _number(top, "resume_s", resume_s, LONGEST_PAUSE_S), stages, str(scenario))


def _of_leg(given: Any, leg: str) -> dict[str, Any]:
    """Return parameters of one leg's hardware and person; the training is the same for both."""
    changes = mapping(given, leg)
    for key in changes:
        if not str(key).startswith(("plant.", "leg.person.", "control.limits.")):
            raise OrthosisError(
                f"{leg}: {key} is no parameter of a leg: plant., leg.person. or control.limits."
            )
    return changes


def _stages(given: Any, shared: Parameters) -> tuple[Stage, ...]:
    if not isinstance(given, list) or not given:
        raise OrthosisError("stages: give a list of strides and pauses")
    stages: list[Stage] = []
    changes: dict[str, Any] = {}
    total = 0.0
    for number, one in enumerate(given, 1):
        stage = _stage(mapping(one, f"stage {number}"), f"stage {number}")
        changes |= stage.changes
        with naming(f"stage {number}"):
            cycle = shared.changed(changes).scenario.cycle_time
        total += stage.strides * cycle + stage.pause
        stages.append(stage._replace(changes=dict(changes)))
    if not any(stage.strides for stage in stages):
        raise OrthosisError("stages: none has strides")
    if total > LONGEST_S:
        raise OrthosisError(f"stages: they last {total:.0f} s, at most {LONGEST_S:.0f} s")
    return tuple(stages)


def _stage(given: dict[str, Any], where: str) -> Stage:
    check_keys(given, OF_STAGE, where)
    if ("strides" in given) == ("pause_s" in given):
        raise OrthosisError(f"{where}: give either strides or pause_s")
    strides, pause = given.get("strides", 1), _number(given, "pause_s", 0.0, LONGEST_PAUSE_S, where)
    if type(strides) is not int or not 1 <= strides <= MOST_STRIDES:
        raise OrthosisError(f"{where}: strides: {strides!r} is not an integer from 1 to {MOST_STRIDES}")
    if pause and given.keys() - {"name", "pause_s"}:
        raise OrthosisError(f"{where}: a pause has nothing but a name and pause_s")
    name = _name(given.get("name", "pause" if pause else where), where)
    changes = {key: given[short] for short, key in SETTINGS.items() if short in given}
    if "cycle_time_s" in given:
        changes["scenario.cycle_time"] = given["cycle_time_s"]
    return Stage(name, 0 if pause else strides, pause, changes)


def _name(name: Any, where: str) -> str:
    if not isinstance(name, str) or not name.isprintable() or not 0 < len(name) <= 40:
        raise OrthosisError(f"{where}: name: give a text of at most 40 characters")
    return name


def _number(given: Mapping[str, Any], key: str, default: float, most: float, where: str = "") -> float:
    """Return a time, s; where it is given it is above zero."""
    value = given.get(key, default)
    usable = isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= most
    if key in given and not usable:
        raise OrthosisError(
            f"{where and where + ': '}{key}: {value!r} is not a number above 0, up to {most:g}"
        )
    return float(value)
