# SPDX-License-Identifier: Apache-2.0
"""Blind recordings of the test rig, run by the rig's own controllers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pam_orthosis.control.rig_loop import DIAGNOSTIC_START, Rig, diagnostic_procedure
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.testing.case import Recording
from pam_orthosis.testing.plant import NO_DEVIATION
from pam_orthosis.testing.quantities import Hidden
from pam_orthosis.testing.rig_plant import HiddenRig

SPECIMEN = "dmsp_20"


def nominal() -> Parameters:
    """Return what is known of the rig of all cases: the nominal model, without any effect."""
    return load({"valve.dead_band": 0.0})


def record(
    rng: np.random.Generator,
    parameters: Parameters,
    hidden: Hidden,
    deviations: Mapping[str, float] = NO_DEVIATION,
) -> Recording:
    """Return one diagnostic run in closed loop at drawn pressures and places; arguments as of `HiddenRig`."""
    plant = HiddenRig(parameters, hidden, deviations, DIAGNOSTIC_START, int(rng.integers(2**31)))
    pressures = np.array([3.2e5, 5.5e5]) + rng.uniform(-2e4, 4e4, 2)
    places = rng.permutation([0.15, 0.5, 0.8, 1.0])
    rig = Rig(parameters, SPECIMEN, position=DIAGNOSTIC_START, plant=plant)
    rows = [
        (s.time_ns * 1e-9, s.measured.position, s.measured.force, *s.measured[1:3], *s.voltages)
        for s in diagnostic_procedure(rig, pressures[rng.permutation(2)].tolist(), places.tolist())
    ]
    names = ("time", "rig_position", "rig_force", "rig_pressure", "rig_positioner_pressure",
             "rig_voltage", "rig_positioner_voltage")  # fmt: skip
    return dict(zip(names, np.array(rows).T, strict=True))
