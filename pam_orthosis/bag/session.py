# SPDX-License-Identifier: Apache-2.0
"""A training session as a bag of both legs: what the graph would record, and what the programme did."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.arrays import write_legs
from pam_orthosis.bag.read import recorded_parameters, run_record
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.bag.sampled import sampled
from pam_orthosis.bag.simulated import recorded_signals
from pam_orthosis.control.programme import LEGS, Programme
from pam_orthosis.control.session import Done, Event, Trained
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.reading import from_json

RECORD = "session"  # of the run metadata


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
    first, *_ = programme.legs.values()
    names = *recorded_signals(first.declared), "disturbance"
    own = {leg: _differing(first, one) for leg, one in programme.legs.items()}
    run = run_metadata(first, programme.scenario, json.dumps(own)) | {RECORD: _record(programme, trained)}
    legs = {leg: {name: signals[name] for name in names} for leg, signals in trained.signals.items()}
    period_ns = round(first.scenario.control_period * 1e9)
    count = len(next(iter(trained.signals.values()))["time"])
    write_legs(folder, np.arange(count) * period_ns, legs, run)


def is_session(path: Path) -> bool:
    """Whether a bag is of a session; OrthosisError if it is damaged."""
    return RECORD in run_record(path)


def read_session(path: Path) -> Recorded:
    """Read the bag of a session; OrthosisError if it is none."""
    record = run_record(path)
    if RECORD not in record:
        raise OrthosisError(f"{path} is no session; `pam-orthosis session` records one")
    parameters, signals = {}, {}
    for leg in LEGS:
        found = sampled(path, leg)
        values = recorded_parameters(path, found.bag.run, leg)
        parameters[leg] = load(values, found.bag.machine)
        signals[leg] = {"time": found.time, **found.signals}
    try:
        kept = from_json(record[RECORD], str(path))
        strides = [Done(*one) for one in kept["strides"]]
        trips = [Event(*one) for one in kept["trips"]]
        return Recorded(path.name, kept["stages"], strides, trips, kept["ended"], parameters, signals)
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


def _differing(first: Parameters, other: Parameters) -> dict[str, Any]:
    shared = first.flat()
    return {key: value for key, value in other.flat().items() if shared[key] != value}
