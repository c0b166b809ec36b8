# SPDX-License-Identifier: Apache-2.0
"""The device moved by hand when depressurised: the torque that this takes, measured on the emulated hardware.

A hand, a stiff spring with a damper, leads the joint while the valves vent. What it needs beyond weight and
inertia is what friction and muscles resist.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from pam_orthosis.control.trajectory import Trajectory
from pam_orthosis.model.assembly import Hardware
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.passive import knee_moment
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.shapes import scenario_shape
from pam_orthosis.model.truth import true_parameters
from pam_orthosis.progress import Progress, counted, silent

PERIOD = 1.0e-3  # s, of the hand
SETTLING = 1.0  # s at rest at first, in which the muscles vent; not judged
# a relaxed leg in the knee's machine: its mass, and the elastic moment of its tissue
RELAXED = {"leg.person.present": True, "plant.person.tissue.passive_moment.enabled": True}
JOINTS, WEARERS, SPEEDS = ("knee", "ankle"), (False, True), ("slow", "gait")

Motion = Callable[[float], tuple[float, float]]  # time, s -> angle, rad, and velocity, rad/s


@dataclass(frozen=True)
class Moved:
    """A joint moved by hand.

    Attributes:
        joint: `knee` or `ankle`.
        person: whether a person's leg is in the orthosis.
        speed: `slow`, through the whole range, or `gait`.
        angle, velocity: (n,) true ones, rad, rad/s.
        torque: (n,) of the hand, N m.
        weight: (n,) G of Eq. (26) of the true mechanism, with the passive moment of the person's joint, N m.
        inertia: (n,) m q-double-dot + k of it, N m.
    """

    joint: str
    person: bool
    speed: str
    angle: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    weight: np.ndarray
    inertia: np.ndarray

    @property
    def resistance(self) -> np.ndarray:
        """What the hand needs beyond weight and inertia, N m: friction and muscles."""
        return np.asarray(self.torque - self.weight - self.inertia)

    def as_dict(self) -> dict[str, Any]:
        """Return names, range in degrees, and the largest of each torque, N m."""
        kinds = ("torque", "weight", "inertia", "resistance")
        return {
            "joint": self.joint,
            "person": self.person,
            "speed": self.speed,
            "from_deg": math.degrees(self.angle.min()),
            "to_deg": math.degrees(self.angle.max()),
            "speed_deg_s": math.degrees(np.abs(self.velocity).max()),
        } | {kind: float(np.abs(getattr(self, kind)).max()) for kind in kinds}


class Held(Plant):
    """The emulated hardware in a hand; its muscles begin at their mean pressure."""

    def __init__(self, parameters: Parameters, motion: Motion, inertia: float):
        self._motion = motion
        swing = 100.0  # 1/s, of the joint on the hand's spring, critically damped
        self._stiffness, self._damping = inertia * swing**2, 2 * inertia * swing
        super().__init__(parameters)

    def _external(self, time: float) -> Sequence[float]:
        angle, velocity = self._motion(time)
        stretch, slip = angle - float(self.state[0]), velocity - float(self.state[1])
        return (self._stiffness * stretch + self._damping * slip,)

    def _start(self, hardware: Hardware, accelerate: ca.Function) -> np.ndarray:
        x = np.zeros(len(self.states))
        x[0] = self._p.at(self.machine.start)
        x[2 : 2 + len(self.lines)] = self._p.control.position.mean_pressure
        return x


def all_moved(progress: Progress = silent) -> list[tuple[Moved, Moved]]:
    """Return knee and ankle, without a person and with one, slow and at gait speed: vented, and filled."""
    cases = [(joint, person, speed) for joint in JOINTS for person in WEARERS for speed in SPEEDS]
    watched = counted(cases, progress, "moved by hand")
    return [(by_hand(*case), by_hand(*case, filled=True)) for case in watched]


def by_hand(
    joint: str, person: bool, speed: str, filled: bool = False, overrides: Mapping[str, Any] | None = None
) -> Moved:
    """Lead a joint through its range and back, or along its gait.

    A person is relaxed: the mass of a leg, and the passive moment of the joint. The muscles are `filled`
    if they hold their mean pressure behind closed valves; otherwise all valves vent first.
    """
    p = load({"scenario.control_period": PERIOD}, machine_named(Path(joint)))
    relaxed = RELAXED if joint == "knee" else {"leg.person.present": True}
    p = p.changed({**(relaxed if person else {}), **(overrides or {})})
    motion, start, seconds = (_slow if speed == "slow" else _gait)(p)
    p = p.changed({p.declared.start: start})
    function = _terms(p)
    inertia = float(function(start, 0.0)[0])
    voltage = p.valve.closed_voltage if filled else p.valve.minimum_voltage
    plant, rows = Held(p, motion, inertia), []
    for _ in range(round(seconds / PERIOD)):
        plant.advance(*[voltage] * len(plant.lines))
        rows.append(plant.truth()[:3])
    settled = round(SETTLING / PERIOD)
    angle, velocity, torque = np.array(rows)[settled:].T
    acceleration = np.gradient(velocity, PERIOD)
    mass, carried, weight = (part.full()[0] for part in function(angle[None, :], velocity[None, :]))
    # the hand's torque is held for a period: it belongs to the middle of it
    torque = 0.5 * (torque[:-1] + torque[1:])
    cut = slice(None, -1)
    return Moved(
        joint, person, speed, angle[cut], velocity[cut], torque, weight[cut],
        (mass * acceleration + carried)[cut],
    )  # fmt: skip


def _slow(p: Parameters) -> tuple[Motion, float, float]:
    """Return a slow motion from stop to stop and back, its start, rad, and its duration, s."""
    low, high = (float(end) for end in p.declared.mechanism(p).limits)
    clear = 0.02  # rad, of the stops
    low, half = low + clear, 0.5 * (high - low) - clear
    seconds = 20.0  # through the range and back
    rate = 2 * math.pi / seconds

    def motion(time: float) -> tuple[float, float]:
        since = rate * max(time - SETTLING, 0.0)
        return low + half * (1 - math.cos(since)), half * rate * math.sin(since)

    return motion, low, SETTLING + seconds


def _gait(p: Parameters) -> tuple[Motion, float, float]:
    """Return the gait of the scenario, its start, rad, and its duration, s."""
    s = p.scenario
    trajectory = Trajectory(scenario_shape(p), s.cycle_time, SETTLING, s.start_ramp, s.start_phase)

    def motion(time: float) -> tuple[float, float]:
        reference = trajectory.sample(round(time * 1e9))
        return reference.position, reference.velocity

    return motion, motion(0.0)[0], SETTLING + s.start_ramp + 2 * s.cycle_time


def _terms(p: Parameters) -> ca.Function:
    """Return (angle, velocity) -> m, k and G of Eq. (26) of the true mechanism, the knee's tissue in G."""
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    terms, gravity = p.declared.mechanism(true_parameters(p)).terms(q, velocity), 0
    tissue = p.plant.person.tissue
    if p.declared.kind == "knee" and tissue.passive_moment.enabled:
        hip = leg.hip_angle(q, p.leg)
        gravity = -tissue.passive_moment.scale * knee_moment(q * 180 / math.pi, hip * 180 / math.pi)
    return ca.Function("true_terms", [q, velocity], [terms.inertia, terms.coriolis, terms.gravity + gravity])
