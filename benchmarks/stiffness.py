# SPDX-License-Identifier: Apache-2.0
"""Stiffness of the joint over the co-contraction p_im, by the model and from recordings.

python benchmarks/stiffness.py > benchmarks/results/stiffness.md
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.control.axis import Axis
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import Demand, pressures_for_effort
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.parameters import load, scenario_overrides

MEANS = (2.6e5, 3.1e5, 3.6e5, 4.1e5, 4.6e5)  # absolute Pa
WARM_UP = 4.0  # s
DRY = {f"plant.effects.{name}.enabled": False for name in ("joint_friction", "muscle_hysteresis")}
LEAST_CYCLES = 2  # of the torque that a stiffness is measured with


class Stiffness(NamedTuple):
    """Torque against a deflection of the knee, N m/rad: pressures held, and valves closed."""

    held: float
    closed: float


def modelled(parameters, angle: float, mean_pressure: float) -> Stiffness:
    """Return the stiffness that the controllers' model has at rest at an angle, rad, with p_im, absolute Pa.

    -dM/dq of Eq. (27) and gravity at constant pressures; with closed valves the gas of Eq. (6) adds to it
    what its pressure rises by when the muscle's volume shrinks. The pressures are those with which the
    position controller holds the knee: where p_im would let a muscle hang slack they are higher.
    """
    axis = Axis(parameters.nominal())
    nominal = axis.nominal
    q, velocity, p = ca.SX.sym("q"), ca.SX.sym("velocity"), ca.SX.sym("p", 2)
    moving = axis.effort(q, velocity, (p[0], p[1])) - axis.terms(q, velocity).gravity
    torque = ca.substitute(moving, velocity, 0)
    volume, dead = _volumes(q, p, axis), nominal.valve.hose.volume
    # dp/dq at closed valves: Eq. (6) without flow, the angle in the place of time
    slopes = [(ca.jacobian(volume[i], p[i]), ca.jacobian(volume[i], q)) for i in range(2)]
    rates = [
        pneumatics.pressure_rate(p[i], 0, 1, volume[i] + dead, *slopes[i], nominal.valve) for i in range(2)
    ]
    held = -ca.jacobian(torque, q)
    closed = held - ca.jacobian(torque, p) @ ca.vertcat(*rates)
    pressures = _holding(angle, mean_pressure, axis)
    return Stiffness(*(float(v) for v in ca.Function("k", [q, p], [held, closed])(angle, pressures)))


def measured(time, angle, torque, frequency: float, warm_up: float) -> float:
    """Return the stiffness from a recording of an angle, rad, under a sinusoidal torque, N m/rad.

    The torque's part in phase with the angle over the angle, both at the torque's frequency, Hz, over whole
    cycles after `warm_up`, s: friction answers a quarter of a cycle off. ValueError if there are fewer than
    two cycles.
    """
    cycles = int((time[-1] - warm_up) * frequency + 1e-6)
    if cycles < LEAST_CYCLES:
        raise ValueError(f"{cycles} whole cycles after {warm_up} s are too few")
    part = (time >= warm_up) & (time < warm_up + cycles / frequency)
    wave = np.exp(-2j * np.pi * frequency * time[part])
    pushed, moved = (np.mean((x[part] - x[part].mean()) * wave) for x in (torque, angle))
    return abs(float(np.real(pushed / moved)))


def _volumes(q, p, axis):
    contractions, _ = axis.kinematics(q, 0)
    gauge = [p[i] - axis.nominal.valve.ambient_pressure for i in range(2)]
    return [one.volume(x, g) for one, x, g in zip(axis.actuators, contractions, gauge, strict=True)]


def _holding(angle: float, mean: float, axis):
    """Return the absolute pressures that the position controller holds the knee with, in their limits."""
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    held = pressures_for_effort(Demand(axis.terms(q, velocity).gravity, q, velocity, mean), axis)
    gauge = ca.Function("held", [q, velocity], [ca.vertcat(*held.pressures)])(angle, 0)
    return gauge + axis.nominal.valve.ambient_pressure


def on_plant(parameters) -> tuple[float, float]:
    """Return stiffness, N m/rad, and largest deflection, rad, measured with closed valves."""
    run = ClosedLoop(parameters, 1).run(round(parameters.scenario.duration / 0.005))
    angle = run["angle"][run["time"] > WARM_UP]
    frequency = parameters.plant.external_frequency
    found = measured(run["time"], run["angle"], run["true_torque"], frequency, WARM_UP)
    return found, 0.5 * (angle.max() - angle.min())


def main() -> None:
    """Print a row for each p_im: stiffness, N m/rad, and the largest deflection."""
    print("| p_im | model, pressures held | model, valves closed | measured | no dry friction | deflection |")
    print("|---|---|---|---|---|---|")
    for mean in MEANS:
        p = load({
            **scenario_overrides("diagnostic-stiffness"), "control.position.mean_pressure": mean,
            "scenario.control_period": 0.005,
        })  # fmt: skip
        model = modelled(p, p.scenario.start_angle, mean)
        stiffness, deflection = on_plant(p)
        dry, _ = on_plant(p.changed(DRY))
        print(f"| {mean * 1e-5:.1f} bar | {model.held:.1f} | {model.closed:.1f} | {stiffness:.1f} | {dry:.1f}"
              f" | {57.3 * deflection:.1f} deg |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
