# SPDX-License-Identifier: Apache-2.0
"""Fig. 8: the observer under a sinusoidal disturbance, its lag, its noise, and what one costs the other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from pam_orthosis.bag.tracking import rms
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters as tree
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.truth import as_modelled
from pam_orthosis.progress import Progress, counted, silent

SCENARIO, GAIT = "observer", "default"
SETTLING = 4.0  # s, not judged: the sine rises, and the observer does not know the disturbance yet
PATTERNS = {1.0: "three equal poles", 0.5: "Butterworth pattern"}
POLE, DAMPING = "control.observer.pole", "control.observer.damping"


@dataclass(frozen=True)
class ObserverRun:
    """The knee under a sinusoidal torque: what was true, what was estimated, and how far apart.

    Attributes:
        parameters: of the run.
        signals: arrays by name, as `control.loop.signals`.
        disturbance_time: (n,) instants of `disturbance`, s.
        disturbance: (n,) the true disturbance torque of Eq. (26), N m.
        lag: of the estimated disturbance at its frequency, s.
        gain: amplitude of the estimated disturbance / true amplitude.
        velocity_noise: standard deviation of the estimated velocity's error, rad/s.
    """

    parameters: Parameters
    signals: Mapping[str, np.ndarray]
    disturbance_time: np.ndarray
    disturbance: np.ndarray
    lag: float
    gain: float
    velocity_noise: float


@dataclass(frozen=True)
class TradeOff:
    """One setting of the observer: its lag and noise, and what the walking knee makes of it."""

    pole: float
    damping: float
    lag: float
    velocity_noise: float
    max_error_deg: float
    rms_error_deg: float
    voltage_variation: float


class WatchedPlant(Plant):
    """The plant, with a list of its true states, one each step."""

    def __init__(self, parameters: Parameters, seed: int):
        super().__init__(parameters, seed)
        self.seen: list[Any] = []

    def truth(self) -> Any:
        """Return the true state, and keep it."""
        self.seen.append(super().truth())
        return self.seen[-1]


def observe(overrides: Mapping[str, Any] | None = None, exact: bool = True, seed: int = 1) -> ObserverRun:
    """Move the knee under the scenario's sinusoidal torque and watch the observer.

    Args:
        overrides: parameters beside those of the scenario.
        exact: the plant is the observer's model, as in the paper's simulation, and the torque is the
            only disturbance; otherwise the emulated hardware with all its effects, whose disturbance
            is what Eq. (26) needs beside the torque to explain the true motion.
        seed: of the sensor noise.
    """
    fixed = as_modelled(tree.load()) if exact else {}
    p = tree.load({**tree.scenario_overrides(SCENARIO), **fixed, **(overrides or {})})
    plant = WatchedPlant(p, seed)
    signals = ClosedLoop(p, seed, plant=plant).run(round(p.scenario.duration / p.scenario.control_period))
    instants, true = _torque(signals, p) if exact else _missing_torque(signals, plant.seen, p)
    return _judged(p, signals, instants, true)


def trade_off(progress: Progress = silent) -> list[TradeOff]:
    """Return lag, noise and the tracking of the gait for each pattern and distance of the poles."""
    settings = list(product(PATTERNS, (50.0, 65.0, 80.0, 110.0, 150.0)))
    watched = counted(settings, progress, "fig. 8: trade-off of the observer")
    return [_one(pole, damping) for damping, pole in watched]


def fundamental(
    time: np.ndarray, signal: np.ndarray, frequencies: Sequence[float]
) -> tuple[float, float, np.ndarray]:
    """Return amplitude and phase (rad) at the first frequency (Hz), and what is not periodic in a signal."""
    orders = [2 * np.pi * f * n for n in (1, 2, 3, 4) for f in frequencies]
    waves = [wave(order * time) for order in orders for wave in (np.cos, np.sin)]
    regressors = np.column_stack([*waves, np.ones_like(time), time])
    found = np.linalg.lstsq(regressors, signal, rcond=None)[0]
    return float(np.hypot(*found[:2])), float(np.arctan2(-found[1], found[0])), signal - regressors @ found


def lag_and_gain(
    time: np.ndarray,
    signal: np.ndarray,
    late_time: np.ndarray,
    late: np.ndarray,
    frequencies: Sequence[float],
) -> tuple[float, float]:
    """Return how late a signal repeats another one at the first frequency, s, and amplitude / amplitude."""
    amplitude, phase, _ = fundamental(time, signal, frequencies)
    late_amplitude, late_phase, _ = fundamental(late_time, late, frequencies)
    behind = (phase - late_phase + np.pi) % (2 * np.pi) - np.pi
    return behind / (2 * np.pi * frequencies[0]), late_amplitude / amplitude


def _judged(
    p: Parameters, signals: Mapping[str, np.ndarray], instants: np.ndarray, true: np.ndarray
) -> ObserverRun:
    frequencies, time = (p.plant.external_frequency, 1 / p.scenario.cycle_time), signals["time"]
    settled, later = instants >= SETTLING, time >= SETTLING
    estimated = signals["disturbance"][later]
    lag, gain = lag_and_gain(instants[settled], true[settled], time[later], estimated, frequencies)
    error = (signals["estimate_velocity"] - signals["true_velocity"])[later]
    noise = float(fundamental(time[later], error, frequencies)[2].std())
    return ObserverRun(p, signals, instants, true, lag, gain, noise)


def _torque(signals: Mapping[str, np.ndarray], p: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Return the applied torque as a disturbance: each value acted for the period before its stamp."""
    return signals["time"] - p.scenario.control_period / 2, -signals["true_torque"]


def _missing_torque(
    signals: Mapping[str, np.ndarray], seen: Sequence[Any], p: Parameters
) -> tuple[np.ndarray, np.ndarray]:
    """Return tau of Eq. (26) from the true motion and pressures with the controllers' model."""
    axis = Axis(p.nominal())
    q, velocity, acceleration, pe, pf = (ca.SX.sym(name) for name in ("q", "v", "a", "pe", "pf"))
    terms, torque = axis.terms(q, velocity), axis.effort(q, velocity, (pe, pf))
    missing = torque - terms.inertia * acceleration - terms.coriolis - terms.gravity
    function = ca.Function("tau", [q, velocity, acceleration, pe, pf], [missing])
    rates = np.gradient(signals["true_velocity"], p.scenario.control_period)
    pressures = np.array([[one.extensor_pressure, one.flexor_pressure] for one in seen]).T
    states = signals["true_angle"], signals["true_velocity"], rates, *pressures
    return signals["time"], function(*(np.atleast_2d(s) for s in states)).full()[0]


def _one(pole: float, damping: float) -> TradeOff:
    settings = {POLE: pole, DAMPING: damping}
    held = observe(settings)
    p = tree.load({**tree.scenario_overrides(GAIT), **settings})
    seconds = 9.0
    run = ClosedLoop(p, seed=1).run(round(seconds / p.scenario.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    variation = np.abs(np.diff(run["extensor_voltage"])).sum() / seconds
    return TradeOff(
        pole, damping, held.lag, held.velocity_noise,
        float(np.abs(error).max()), rms(error), float(variation),
    )  # fmt: skip
