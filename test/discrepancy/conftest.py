# SPDX-License-Identifier: Apache-2.0
"""Short recordings of the closed loop, made once."""

import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.data import from_arrays
from pam_orthosis.discrepancy.knee import knee
from pam_orthosis.discrepancy.replay import Replay
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load

SECONDS = 14.0
# a plant that is as believed
BELIEVED = {
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
    """Recordings of plants that differ from the belief in what is asked for."""

    def __init__(self):
        self.parameters = load(BELIEVED)
        self.system = knee(self.parameters)
        self.replay = Replay(self.system)
        self._known = {}

    def arrays(self, seed, cycle_time=2.0, **plant):
        key = (seed, cycle_time, tuple(sorted(plant.items())))
        if key not in self._known:
            changed = {name.replace("__", "."): value for name, value in plant.items()}
            parameters = load({**BELIEVED, "scenario.cycle_time": cycle_time, **changed})
            self._known[key] = ClosedLoop(parameters, seed).run(round(SECONDS / 0.002))
        return self._known[key]

    def recording(self, seed, cycle_time=2.0, **plant):
        return from_arrays(f"run {seed}", self.system, self.arrays(seed, cycle_time, **plant))


@pytest.fixture(scope="session")
def bench():
    return Bench()
