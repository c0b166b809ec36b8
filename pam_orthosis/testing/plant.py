# SPDX-License-Identifier: Apache-2.0
"""The hidden plant: what `model.plant.Plant` is to the controllers, built from `physics` alone."""

from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.testing import physics
from pam_orthosis.testing.effects import Scale
from pam_orthosis.testing.loads import Load, load_of
from pam_orthosis.testing.mechanics import strokes
from pam_orthosis.testing.quantities import Apparatus, Hidden, Maps, damping_of, laws, maps, muscle_and_valve

ANGLE_NOISE, ANGLE_RESOLUTION = 3.5e-4, 3.8349519697141030e-4  # rad
PRESSURE_NOISE, PRESSURE_RESOLUTION = 500.0, 244.0  # Pa
VOLTAGE_RESOLUTION = 10.0 / 65536
NO_DEVIATION: Mapping[str, float] = {}
NO_MISFIT: Mapping[str, np.ndarray] = {}


class Truth(NamedTuple):
    """What the closed loop records of the true state, SI; the effort from outside is not known here."""

    position: float
    velocity: float
    effort: float = float("nan")


class HiddenPlant:
    """Emulated hardware for blind tests, advanced one control period at a time.

    Args:
        parameters: the nominal model; what the plant is without deviations, misfits and hidden effects.
        hidden: sizes of the hidden effects; a hidden dead time comes on top of the nominal one.
        deviations: of the nuisance parameters, keys as `motions.tolerances` has them.
        misfits: arrays of `Maps` that differ from none (force_waves, valve_waves, volume_waves, torque).
        seed: of the sensor noise.
    """

    def __init__(
        self,
        parameters: Parameters,
        hidden: Hidden = Hidden(),  # noqa: B008 immutable
        deviations: Mapping[str, float] = NO_DEVIATION,
        misfits: Mapping[str, np.ndarray] = NO_MISFIT,
        seed: int = 0,
    ):
        machine, off = parameters.declared, defaultdict(float, deviations)
        period = parameters.scenario.control_period
        self.period_ns = round(period * 1e9)
        self._steps = round(period / physics.STEP)
        hidden = hidden._replace(valve_delay=parameters.valve.delay + hidden.valve_delay)
        self._parts = (*apparatuses(parameters, off), hidden, *_maps(parameters, off, misfits))
        self._a = self._parts[0]
        self._offsets = [off[f"{name}_offset"] for name in machine.channels]
        noise, step = _coordinate_sensor(parameters)
        self._spread = (noise, PRESSURE_NOISE, PRESSURE_NOISE)
        self._resolution = (step, PRESSURE_RESOLUTION, PRESSURE_RESOLUTION)
        self._noise = np.random.default_rng(seed)
        self._closed = parameters.valve.closed_voltage
        self._index = 0
        self._volts = tuple(off[f"{name}_closed_voltage"] for name in machine.names)
        self._start(parameters)

    def measure(self) -> tuple[float, ...]:
        """Return noisy, quantised sensor readings: coordinate, absolute pressures Pa. It draws noise."""
        true, noise = self._sense(), self._noise.standard_normal(3)
        values = (x + o + s * n for x, o, s, n in zip(true, self._offsets, self._spread, noise, strict=True))
        return tuple(round(v / step) * step for v, step in zip(values, self._resolution, strict=True))

    def advance(self, *voltages: float) -> None:
        """Integrate one control period with the voltages of both valves held."""
        ue, uf = self._above_closed(*voltages)
        self._index = physics.advance(
            self.x, self._wheel, self._spools, self._anchors, self._ring, self._index, self._steps,
            ue, uf, *self._parts,
        )  # fmt: skip

    def truth(self) -> Truth:
        """Return the true position and velocity."""
        return Truth(*self.x[:2].tolist())

    def _sense(self) -> tuple[float, float, float]:
        ue, uf = self._spools.tolist()
        return physics.sense(
            self.x, self._wheel, self._anchors, self._ring, self._index, ue, uf, *self._parts
        )

    def _above_closed(self, *voltages: float) -> tuple[float, float]:
        exact = (min(max(v - self._closed, -self._a.half_span), self._a.half_span) for v in voltages)
        quantised = (round(v / VOLTAGE_RESOLUTION) * VOLTAGE_RESOLUTION for v in exact)
        first, second = (v + shift for v, shift in zip(quantised, self._volts, strict=True))
        return first, second

    def _start(self, parameters: Parameters) -> None:
        """Find the state at rest with closed valves at the start, pressures about the mean."""
        mean = parameters.control.position.mean_pressure
        place = parameters.at(parameters.declared.start)
        self.x = np.zeros(physics.STATES)
        self.x[:4] = place, 0.0, mean, mean
        self._wheel, self._spools = np.array([place]), np.zeros(2)
        first, second, *slopes = strokes(place, 1.0, self._a, self._parts[3])
        self._anchors = np.outer([first, second], np.ones(physics.ELEMENTS))
        self._ring = np.zeros((6, physics.RING))
        pulls, ambient, supply = np.sign(slopes), self._a.ambient, parameters.valve.supply_pressure
        reach = 0.8 * mean if parameters.declared.kind == "knee" else supply - mean
        low, high = -reach, reach
        for _ in range(50 if self._a.locked == 0 else 0):
            shift = 0.5 * (low + high)
            self.x[physics.PE : physics.PF + 1] = np.clip(mean + pulls * shift, ambient, supply)
            low, high = (shift, high) if self._acceleration() < 0 else (low, shift)
        for row, state in ((physics.RING_Q, 0), (physics.RING_PE, 2), (physics.RING_PF, 3)):
            self._ring[row] = self.x[state]

    def _acceleration(self) -> float:
        out = np.zeros(physics.STATES)
        physics.rates(self.x, out, 0.0, 0.0, 0.0, 0.0, self._wheel[0], self._anchors, *self._parts)
        return float(out[physics.W])


def apparatuses(
    parameters: Parameters, deviations: Mapping[str, float] = NO_DEVIATION
) -> tuple[Apparatus, Apparatus]:
    """Return the true parameters, each with one of the actuators: nominal values times one plus deviation."""
    machine, off = parameters.declared, defaultdict(float, deviations)
    load = load_of(parameters, off)
    common = {
        "supply": parameters.valve.supply_pressure * (1 + off["supply_pressure"]),
        **dict(zip(("radius", "symmetric_angle", "symmetric_contraction"), load.wound, strict=True)),
        **{f"stop_{name}": getattr(load.stops, f"stop_{name}") for name in ("stiffness", "damping")},
        "stop_low": load.stops.minimum,
        "stop_high": load.stops.maximum,
        "table_start": load.start,
        "table_step": load.step,
        "load_damping": load.damping,
        "middle": load.middle,
        "unit": load.unit,
        "locked": float(dict(load.stops.items()).get("locked", False)),
    }
    first, second = (
        Apparatus(
            **muscle_and_valve(parameters.at(one.parameters), parameters.valve, off),
            damping=damping_of(one, parameters, off),
            force=1 + off[f"{one.name}_force"],
            pushes=float(one.kind == "cylinder"),
            **common,
        )
        for one in machine.actuators
    )
    return first, second


def _maps(
    parameters: Parameters, off: Mapping[str, float], misfits: Mapping[str, np.ndarray]
) -> tuple[Maps, Maps]:
    load: Load = load_of(parameters, off)
    tables = {"load": load.table, "strokes": load.strokes, **misfits}
    first, second = (maps(laws(one, parameters), **tables) for one in parameters.declared.actuators)
    return first, second


def _coordinate_sensor(parameters: Parameters) -> tuple[float, float]:
    """Return noise and step of the coordinate's sensor: a user's machine has its own."""
    sensor = parameters.declared.sensor
    if sensor.startswith("plant."):
        return ANGLE_NOISE, ANGLE_RESOLUTION
    finest = 1e-12  # step of a sensor without one
    return parameters.at(f"{sensor}_noise"), parameters.at(f"{sensor}_resolution") or finest


def scale_of(parameters: Parameters) -> Scale:
    """Return by what sizes of effects that were chosen for the knee are larger in a machine."""
    if parameters.declared.kind == "knee":
        return Scale()
    known, none = load(), defaultdict(float, NO_DEVIATION)
    (first, _), (of_knee, _) = (_maps(one, none, NO_MISFIT) for one in (parameters, known))
    own, other = apparatuses(parameters)[0], apparatuses(known)[0]
    force = first.a[0] / of_knee.a[0]
    effort = force * np.abs(first.strokes[[1, 3]]).max() / other.radius
    volume = first.v[0] * other.stroke_scale / (of_knee.v[0] * own.stroke_scale)
    flow = own.conductance / other.conductance
    return Scale(effort, effort / own.unit, own.unit, force, volume, flow, 1 / flow)
