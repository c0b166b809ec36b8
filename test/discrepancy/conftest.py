# SPDX-License-Identifier: Apache-2.0
"""Short recordings of the closed loop, made once."""

import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.testing import case as cases

SECONDS = 14.0
# a plant that is as the nominal model says
OF_NOMINAL = {
    **{f"plant.effects.{name}.enabled": False for name in KNEE.catalogue},
    "plant.muscle_law": "polynomial",
    "plant.simulation.step": 5e-5,
    "valve.dead_band": 0.0,
    "valve.delay": 0.0,
    **{f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")},
    "scenario.control_period": 0.002,
    "scenario.start_hold": 0.3,
    "scenario.start_ramp": 0.7,
    **{
        f"plant.deviation.{name}": 1.0
        for name in (
            "moving_mass", "person_mass", "muscle_damping", "extensor_force", "flexor_force",
            "conductance", "critical_ratio", "polytropic_exponent", "supply_pressure",
        )
    },
}  # fmt: skip


class Bench:
    """Recordings of plants that differ from the nominal model in what is asked for."""

    def __init__(self):
        self.parameters = load(OF_NOMINAL)
        self.system = knee(self.parameters)
        self.replay = Replay(self.system, Workers(2))
        self.problem = Problem(self.replay, [])
        self._known = {}

    def arrays(self, seed, cycle_time=2.0, **plant):
        key = (seed, cycle_time, tuple(sorted(plant.items())))
        if key not in self._known:
            changed = {name.replace("__", "."): value for name, value in plant.items()}
            parameters = load({**OF_NOMINAL, "scenario.cycle_time": cycle_time, **changed})
            self._known[key] = ClosedLoop(parameters, seed).run(round(SECONDS / 0.002))
        return self._known[key]

    def recording(self, seed, cycle_time=2.0, **plant):
        return from_arrays(f"run {seed}", self.system, self.arrays(seed, cycle_time, **plant))


@pytest.fixture(scope="session")
def bench():
    return Bench()


@pytest.fixture(scope="session")
def diagnostics():
    """Take what `make_case` takes; return system, and its diagnostic experiments to fit and to judge."""

    def made(*arguments, **named):
        with pytest.MonkeyPatch.context() as patch:  # gaits are drawn, but none is looked at
            patch.setattr(cases, "GAIT_SECONDS", 0.1)
            patch.setattr(cases, "HELD_OUT_GAIT_SECONDS", 0.1)
            case = cases.make_case(*arguments, **named)
        system = knee(case.parameters)
        groups = case.training, case.held_out
        return system, *(from_arrays("diagnostic", system, group["diagnostic"]) for group in groups)

    return made
