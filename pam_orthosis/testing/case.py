# SPDX-License-Identifier: Apache-2.0
"""Blind cases: recordings of a plant with hidden effects, and the answer, all drawn from a seed.

A case has two training and two held-out recordings in closed loop, of a gait and of diagnostic
experiments, with trajectories of their own. In every case, also one that hides nothing, the nuisance
parameters are off by 0.7 of their stated tolerance. In the class `realistic` static force map,
valve curve and volume differ from the model's in shape as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator

from pam_orthosis.control import diagnostic
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.trajectory import Trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, Section, load
from pam_orthosis.model.shapes import fourier_shape
from pam_orthosis.progress import Progress, part, silent
from pam_orthosis.testing import motions
from pam_orthosis.testing.effects import (
    EFFECTS,
    OUTSIDE,
    PUSHES,
    SIZES,
    WANDER,
    HiddenEffect,
    Scale,
    of_machine,
)
from pam_orthosis.testing.plant import HiddenPlant, scale_of
from pam_orthosis.testing.quantities import Hidden

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

CLASSES = ("clean", "realistic")
# the nominal model of all cases: slower loops than the default, so that a hidden delay of 8 ms stays stable
NOMINAL = {
    "scenario.control_period": 0.002,
    "scenario.start_angle": 0.6,
    "scenario.start_hold": 0.5,
    "valve.dead_band": 0.0,
    "valve.delay": 0.0,
    "control.observer.pole": 70.0,
    "control.observer.damping": 1.0,
    "control.position.c1": 22.0,
    "control.position.c2": 22.0,
    "control.pressure.gain": 40.0,
    "control.pressure.reference_filter": 50.0,
}
OF_MACHINES = "scenario.control_period", "scenario.start_hold", "valve.delay"  # a file may state others
GAIT_SECONDS, HELD_OUT_GAIT_SECONDS, PUSH_SECONDS = 20.0, 14.0, 120.0
WAVES = 9  # of a torque that wanders
CENTRE = np.array([0.08] + [0.0] * 6)  # rad: keeps drawn gaits off the stops
PARTS = (diagnostic.triangle, diagnostic.cocontraction, diagnostic.closed_hold, diagnostic.decay)

Recording = dict[str, np.ndarray]
Run = tuple[Any, float]  # trajectory, duration s


@dataclass(frozen=True)
class Case:
    """Recordings (arrays by the names of `control.loop.signals`), nominal model, and the sealed answer."""

    training: dict[str, Recording]
    held_out: dict[str, Recording]
    parameters: Parameters
    answer: dict[str, Any]


@dataclass(frozen=True)
class Secret:
    """What the plant of a case is."""

    hidden: Hidden
    deviations: dict[str, float]
    misfits: dict[str, np.ndarray]
    answer: dict[str, Any]


def nominal(machine: Machine | None = None) -> Parameters:
    """Return what is known of the apparatus of all cases: the nominal model, without any effect.

    Raises:
        OrthosisError: it cannot be emulated.
    """
    if machine is None or machine.kind == "knee":
        own = load(NOMINAL, machine)
    else:
        known = {key: NOMINAL[key] for key in OF_MACHINES if key not in machine.values}
        own = load({**known, "valve.dead_band": 0.0}, machine)  # the plant has none to compensate
        loops = {key: value for key, value in NOMINAL.items() if key.startswith("control.")}
        own = own.changed({key: min(value, own.at(key)) for key, value in loops.items()})
    present = (key for key in own.flat() if key.startswith("effects.") and own.at(key) is True)
    return own.changed(dict.fromkeys(present, False))


def make_case(
    seed: int,
    class_: str = "clean",
    size: str = "medium",
    effects: int | str | Sequence[str] = 1,
    outside: bool = False,
    alone: str | None = None,
    progress: Progress = silent,
    parameters: Parameters | None = None,
    wrong: Mapping[str, float] | None = None,
) -> Case:
    """Draw a case of a class of `CLASSES` and a size of `SIZES`, which follows from its seed, and record it.

    Args:
        effects: how many effects are drawn, or their names.
        outside: draw from the effects outside the catalogue.
        alone: of the effects that are drawn the only one to hide ("": none); all else stays as it is.
        parameters: the nominal model, of any machine of two actuators (the knee's).
        wrong: values of the plant's parameters of which the nominal model has others.

    Raises:
        OrthosisError: unknown class, size or effect, or a machine that cannot be emulated.
    """
    rng = np.random.default_rng([seed, 4])
    parameters = nominal() if parameters is None else parameters
    secret = draw(rng, parameters, class_, size, effects, outside, alone)
    training, held_out = trajectories(rng, parameters), trajectories(rng, parameters, held_out=True)
    seeds = iter(rng.integers(2**31, size=len(training) + len(held_out)).tolist())

    whole, begun = sum(seconds for _, seconds in (*training.values(), *held_out.values())), 0.0

    def recorded(kind: str, runs: Mapping[str, Run]) -> dict[str, Recording]:
        nonlocal begun
        made = {}
        for name, run in runs.items():
            watched = part(progress, f"recording {kind}_{name}", begun, run[1], whole, " s")
            made[name] = record(parameters, secret, run, next(seeds), watched, wrong)
            begun += run[1]
        return made

    made = recorded("training", training), recorded("held_out", held_out)
    return Case(*made, parameters, {"seed": seed, **secret.answer, "wrong": dict(wrong or {})})


def draw(
    rng: Generator,
    parameters: Parameters,
    class_: str,
    size: str,
    effects: int | str | Sequence[str],
    outside: bool = False,
    alone: str | None = None,
) -> Secret:
    """Draw the plant of a case; arguments as in `make_case`."""
    _check(class_, CLASSES, "class")
    _check(size, SIZES, "size")
    scale = scale_of(parameters)
    table = of_machine(OUTSIDE if outside else EFFECTS, parameters.declared, scale)
    chosen = _chosen(rng, table, effects)
    if alone:
        _check(alone, tuple(effect.name for effect in chosen), "effect")
    fields: dict[str, float] = {}
    misfits = realistic_misfits(rng, scale) if class_ == "realistic" else {}
    parts: dict[str, dict[str, float]] = {}
    for effect in chosen:
        hidden = alone in (None, effect.name)
        into = (fields, misfits) if hidden else ({}, {})
        part = _hide(rng, effect, SIZES.index(size), *into)
        parts |= {effect.name: part} if hidden else {}
    tolerance_share = 0.7  # of the stated standard deviation, by which nuisance parameters are off
    deviations = {
        name: tolerance_share * sd * rng.standard_normal()
        for name, sd in motions.tolerances(parameters).items()
        if sd
    }
    answer = {
        "class": class_,
        "size": size,
        "outside": outside,
        "effects": parts,
        "forms": {effect.name: effect.form for effect in chosen if effect.name in parts},
        "same_form": {effect.name: effect.same_form for effect in chosen if effect.name in parts},
        "deviations": deviations,
    }
    return Secret(Hidden(**fields), deviations, misfits, answer)


def record(
    parameters: Parameters,
    secret: Secret,
    run: Run,
    seed: int,
    progress: Progress = silent,
    wrong: Mapping[str, float] | None = None,
) -> Recording:
    """Return one recording in closed loop of a trajectory over its duration.

    `wrong`: values of the plant's parameters of which the controllers have others.
    """
    trajectory, duration = run
    progress("compiling the model")
    own = {name: _begun_anew(maps, seed) if name == PUSHES else maps for name, maps in secret.misfits.items()}
    parameters = started(parameters, trajectory)
    plant = HiddenPlant(parameters.changed(wrong or {}), secret.hidden, secret.deviations, own, seed)
    loop = ClosedLoop(parameters, plant=plant, trajectory=trajectory)
    recording = loop.run(round(duration / parameters.scenario.control_period), progress)
    return {name: values for name, values in recording.items() if not name.startswith("true_")}


def started(parameters: Parameters, trajectory: Any) -> Parameters:
    """Return the parameters with the angle at which a trajectory starts."""
    return parameters.changed({parameters.declared.start: trajectory.sample(0).position})


def trajectories(rng: Generator, parameters: Parameters, held_out: bool = False) -> dict[str, Run]:
    """Return name -> (trajectory, duration s): a gait and diagnostic experiments, drawn anew."""
    seconds = HELD_OUT_GAIT_SECONDS if held_out else GAIT_SECONDS
    if parameters.declared.kind == "knee":
        experiments = _experiments(rng, parameters)
        return {"gait": (_gait(rng, parameters), seconds), "diagnostic": (experiments, experiments.duration)}
    first, second = (motions.own_motion(rng, parameters) for _ in range(2))
    if not parameters.control.position.feedback:  # what is not held anywhere makes no experiments
        return {"first": (first, seconds), "second": (second, seconds)}
    experiments = motions.experiments(rng, parameters, motions.levels(rng, parameters), PARTS)
    return {"motion": (first, seconds), "diagnostic": (experiments, experiments.duration)}


def _gait(rng: Generator, parameters: Parameters) -> Trajectory:
    """Return a gait whose harmonics, cadence and start are drawn about the default's."""
    gait = parameters.scenario.gait
    spread = 1 + 0.1 * rng.standard_normal((2, len(gait.cosine)))
    shape = fourier_shape(np.array(gait.cosine) * spread[0] + CENTRE, np.array(gait.sine) * spread[1])
    return Trajectory(shape, rng.uniform(1.6, 3.0), parameters.scenario.start_hold, 1.0, rng.uniform())


def _experiments(rng: Generator, parameters: Parameters) -> diagnostic.Experiment:
    """Return all diagnostic experiments in random order with drawn angles and pressures."""
    levels = Section("levels", {
        "low_angle": rng.uniform(0.32, 0.48), "high_angle": rng.uniform(0.85, 1.05),
        "low_mean": rng.uniform(3.0e5, 3.4e5), "high_mean": rng.uniform(4.7e5, 5.3e5),
    })  # fmt: skip
    return motions.experiments(rng, parameters, levels, PARTS)


def realistic_misfits(
    rng: Generator,
    scale: Scale = Scale(),  # noqa: B008 immutable
) -> dict[str, np.ndarray]:
    """Return the misfits of the class `realistic`: about 5 N rms, 2 %, 1 %."""
    map_sd, valve_sd, volume_sd = 3.5, 0.02, 0.01
    return {
        "force_waves": force_waves(rng, scale.force * map_sd * rng.standard_normal((2, 4))),
        "valve_waves": _waves(rng, valve_sd * rng.standard_normal(2), 5.0),
        "volume_waves": _waves(rng, volume_sd * rng.standard_normal(2), 2.0),
    }


def force_waves(rng: Generator, amplitudes: np.ndarray) -> np.ndarray:
    """Return (2, k, 4) waves of a smooth map error with these amplitudes (2, k), N."""
    numbers = rng.uniform(-3.5, 3.5, (2, amplitudes.shape[1], 2))
    phases = rng.uniform(0, 2 * np.pi, amplitudes.shape)
    return np.concatenate([amplitudes[..., None], numbers, phases[..., None]], axis=2)


def _waves(rng: Generator, amplitudes: np.ndarray, number: float) -> np.ndarray:
    return np.column_stack([amplitudes, [number] * 2, rng.uniform(0, 2 * np.pi, 2)])


def _hide(
    rng: Generator, effect: HiddenEffect, level: int, fields: dict[str, float], misfits: dict[str, np.ndarray]
) -> dict[str, float]:
    """Enter an effect into fields or misfits; return its true parameters in the catalogue's terms."""
    size = effect.sizes[level] * rng.uniform(0.85, 1.2)
    if effect.signed and rng.uniform() < 0.5:
        size = -size
    if effect.field in MISFITS:
        name = PUSHES if effect.field == WANDER else effect.field
        misfits[name] = MISFITS[effect.field](rng, size)
        return {effect.parameter: size}
    value = 1 + size if effect.around_one else size
    fields[effect.field] = 1.6 / (2 * math.pi * value) / 2 if effect.name == "valve_lag" else value
    extra = dict(effect.others)
    if effect.name == "periodic_torque":
        extra = {"frequency": rng.uniform(0.6, 2.5), "phase": rng.uniform(-math.pi, math.pi)}
        fields.update({f"periodic_{name}": number for name, number in extra.items()})
    return {effect.parameter: value, **extra}


def _pushes(rng: Generator, size: float) -> np.ndarray:
    torque = np.zeros(round(PUSH_SECONDS * 1e3))
    at = rng.uniform(1.0, 4.0)
    while at < PUSH_SECONDS - 1.0:
        width = round(1e3 * rng.uniform(0.15, 0.5))
        push = size * rng.choice([-1, 1]) * rng.uniform(0.6, 1.0) * np.sin(np.linspace(0, np.pi, width))
        torque[round(1e3 * at) :][:width] += push
        at += rng.uniform(1.0, 4.0)
    return torque


def _wander(rng: Generator, size: float) -> np.ndarray:
    """Return a sum of waves of 0.1 to 1.5 Hz, closed over its length."""
    time = 2 * np.pi * np.arange(round(PUSH_SECONDS * 1e3)) / round(PUSH_SECONDS * 1e3)
    waves = [
        np.sin(k * time + rng.uniform(0, 2 * np.pi)) for k in rng.integers(12, 180, WAVES)
    ]  # 0.1 to 1.5 Hz
    return np.asarray(size * np.sqrt(2 / WAVES) * np.sum(np.array(waves), axis=0))


def _begun_anew(torque: np.ndarray, seed: int) -> np.ndarray:
    """Return a torque as another recording meets it: no clock tells when the next push comes."""
    begun = np.random.default_rng([seed, 6]).integers(len(torque))
    anew: np.ndarray = np.roll(torque, begun)
    return anew


MISFITS: dict[str, Callable[[Generator, float], np.ndarray]] = {
    PUSHES: _pushes,
    WANDER: _wander,
    "force_waves": lambda rng, size: force_waves(rng, size / math.sqrt(2) * rng.choice([-1.0, 1.0], (2, 4))),
    "valve_waves": lambda rng, size: _waves(rng, size * rng.choice([-1.0, 1.0], 2), 6.0),
    "volume_waves": lambda rng, size: _waves(rng, size * rng.choice([-1.0, 1.0], 2), 3.0),
}


def _chosen(
    rng: Generator, table: Mapping[str, HiddenEffect], effects: int | str | Sequence[str]
) -> list[HiddenEffect]:
    if isinstance(effects, int):
        if effects > len(table):
            raise OrthosisError(
                f"{effects} effects to hide; there are {len(table)}: {', '.join(sorted(table))}"
            )
        names = rng.choice(sorted(table), size=effects, replace=False).tolist()
    else:
        names = [effects] if isinstance(effects, str) else list(effects)
    for name in names:
        _check(name, tuple(table), "effect")
    return [table[name] for name in names]


def _check(value: str, allowed: Sequence[str], kind: str) -> None:
    if value not in allowed:
        raise OrthosisError(f"no {kind} {value!r} to hide; there are: {', '.join(allowed)}")
