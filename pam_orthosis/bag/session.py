# SPDX-License-Identifier: Apache-2.0
"""A training session as a bag of both legs: what the graph would record, and what the programme did."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.arrays import write_legs
from pam_orthosis.bag.read import recorded_parameters, run_record
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.releases import SESSION
from pam_orthosis.bag.sampled import sampled
from pam_orthosis.bag.simulated import recorded_signals
from pam_orthosis.control.programme import LEGS, Programme
from pam_orthosis.control.session import Done, Event, Trained, trained_in
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import write_text
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.reading import from_json

BESIDE = "session.json"  # in the bag of a graph, whose metadata are written before


class Recorded(NamedTuple):
    """A session that is read.

    Attributes:
        name: of the bag.
        stages: name, mode, cycle time (s), strides and pause (s) of each, by these words.
        strides, trips, ended: as `control.session.Trained` has them.
        parameters, signals: of each leg; signals as `ClosedLoop.run` names them, but for the truth.
    """

    name: str
    stages: list[Mapping[str, Any]]
    strides: list[Done]
    trips: list[Event]
    ended: str
    parameters: dict[str, Parameters]
    signals: dict[str, dict[str, np.ndarray]]


def write_session(folder: Path, programme: Programme, trained: Trained) -> None:
    """Write a bag; OrthosisError if the folder holds one or cannot be written."""
    first, own = differing(programme.legs)
    names = *recorded_signals(first.declared), "disturbance"
    count = len(next(iter(trained.signals.values()))["time"])
    first = first.changed({"scenario.duration": count * first.scenario.control_period})
    run = run_metadata(first, programme.scenario, json.dumps(own)) | {SESSION: _record(programme, trained)}
    legs = {leg: {name: signals[name] for name in names} for leg, signals in trained.signals.items()}
    period_ns = round(first.scenario.control_period * 1e9)
    write_legs(folder, np.arange(count) * period_ns, legs, run)


def write_beside(bag: Path, programme: Programme, trained: Trained) -> None:
    """Write what a programme did into the folder of a graph's bag."""
    write_text(bag / BESIDE, _record(programme, trained))


def is_session(path: Path) -> bool:
    """Whether a bag is of a session; OrthosisError if it is damaged."""
    return bool(_kept(path))


def _kept(path: Path) -> str:
    """Return the record of a session, empty for another bag."""
    with suppress(OSError, UnicodeDecodeError):
        return (path / BESIDE).read_text(encoding="utf-8")
    return run_record(path).get(SESSION, "")


def read_session(path: Path) -> Recorded:
    """Read the bag of a session; OrthosisError if it is none."""
    record = _kept(path)
    if not record:
        raise OrthosisError(f"{path} is no session; `pam-orthosis session` records one")
    parameters, signals = {}, {}
    for leg in LEGS:
        found = sampled(path, leg)
        values = recorded_parameters(path, found.bag.run, leg)
        parameters[leg] = load(values, found.bag.machine)
        signals[leg] = {"time": found.time, **found.signals}
    try:
        kept = from_json(record, str(path))
        done = trained_in(kept)
        return Recorded(path.name, kept["stages"], *done[1:], parameters, signals)
    except (KeyError, TypeError) as error:
        raise OrthosisError(f"{path}: the record of the session is damaged") from error


def _record(programme: Programme, trained: Trained) -> str:
    first, *_ = programme.legs.values()
    stages = []
    for stage in programme.stages:
        now = first.changed(stage.changes)
        stages.append({
            "name": stage.name, "strides": stage.strides, "pause": stage.pause,
            "mode": now.control.cooperation.mode, "cycle_time": now.scenario.cycle_time,
        })  # fmt: skip
    return json.dumps({
        "stages": stages, "strides": trained.strides, "trips": trained.trips, "ended": trained.ended,
    })  # fmt: skip


def differing(legs: Mapping[str, Parameters]) -> tuple[Parameters, dict[str, dict[str, Any]]]:
    """Return the parameters of the first leg, and in what each leg differs from them."""
    first, *_ = legs.values()
    shared = first.flat()
    own = {
        leg: {key: value for key, value in one.flat().items() if shared[key] != value}
        for leg, one in legs.items()
    }
    return first, own
