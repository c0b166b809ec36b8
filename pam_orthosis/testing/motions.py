# SPDX-License-Identifier: Apache-2.0
"""What a machine other than the knee does in a blind case, and by how much it may be off."""

from typing import Any

import numpy as np
from numpy.random import Generator

from pam_orthosis.control import diagnostic
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, Section
from pam_orthosis.model.shapes import fourier_shape, scenario_shape

GAS = ("conductance", "critical_ratio", "polytropic_exponent", "supply_pressure", "hose_volume")
OF_LEG, OF_PERSON = ("moving_mass", "small_muscle_damping"), ("person_mass", "passive_moment")
OF_ACTUATORS = ("force", "closed_voltage", "pressure_offset")


def tolerances(parameters: Parameters) -> dict[str, float]:
    """Return standard deviations of the nuisance parameters of a machine, by name."""
    tolerance, machine = dict(parameters.gap.tolerance.items()), parameters.declared
    if machine.kind == "knee":
        return tolerance
    if machine.parameters == "leg":
        own = {name: tolerance[name] for name in OF_LEG}
        own |= {name: tolerance[name] for name in OF_PERSON if parameters.leg.person.present}
    else:
        own = {"inertia": tolerance["moving_mass"], "damping": tolerance["muscle_damping"]}
    own |= {name: tolerance[name] for name in GAS}
    for kind in OF_ACTUATORS:
        own |= {f"{name}_{kind}": tolerance[f"extensor_{kind}"] for name in machine.names}
    of_metres = parameters.gap.rig.tolerance.position_offset
    offset = tolerance["angle_offset"] if machine.coordinate.unit == "rad" else of_metres
    return {**own, f"{machine.coordinate.name}_offset": offset}


def own_motion(rng: Generator, parameters: Parameters) -> Any:
    """Return the motion of the scenario with another cadence and, of a gait, other harmonics.

    What was planned for one cadence, a sole's course, is asked for with another load.
    """
    s = parameters.scenario
    cycle = s.cycle_time * rng.uniform(0.8, 1.5)
    if s.plan.enabled:
        share = f"{parameters.declared.parameters}.share"
        return make_trajectory(parameters.changed({share: parameters.at(share) * rng.uniform(0.6, 1.1)}))
    if s.trajectory == "gait" and parameters.control.position.feedback:
        spread = 1 + 0.1 * rng.standard_normal((2, len(s.gait.cosine)))
        shape = fourier_shape(np.array(s.gait.cosine) * spread[0], np.array(s.gait.sine) * spread[1])
        return Trajectory(shape, cycle, s.start_hold, 1.0, rng.uniform())
    return make_trajectory(parameters.changed({"scenario.cycle_time": cycle}))


def levels(rng: Generator, parameters: Parameters) -> Section:
    """Return places within what the scenario's motion covers, and mean pressures about the usual one."""
    shape, position = scenario_shape(parameters), parameters.control.position
    places = [shape(phase)[0] for phase in np.linspace(0.0, 1.0, 200)]
    low, span = min(places), float(np.ptp(places))
    least_span = 1e-3  # rad or m that a motion covers
    if span < least_span:
        raise OrthosisError("scenario.trajectory: give a motion; at rest nothing can be found")
    near, far = rng.uniform(0.1, 0.25, 2) * span
    highest = 0.75 * position.maximum_pressure
    return Section("levels", {
        "low_angle": low + near, "high_angle": low + span - far,
        "low_mean": position.mean_pressure * rng.uniform(0.83, 0.94),
        "high_mean": min(position.mean_pressure * rng.uniform(1.3, 1.47), highest),
    })  # fmt: skip


def experiments(rng: Generator, parameters: Parameters, of: Section, parts: Any) -> diagnostic.Experiment:
    """Return diagnostic experiments at these levels, in random order."""
    start = parameters.at(parameters.declared.start)
    script = diagnostic.Script(start, parameters.control.position.mean_pressure)
    for index in rng.permutation(len(parts)):
        parts[index](script, of)
    rest = parameters.gap.replay.warm_up + parameters.scenario.start_hold  # nothing is lost in the warm-up
    return diagnostic.Experiment(script.phases, rest)
