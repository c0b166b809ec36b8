# SPDX-License-Identifier: Apache-2.0
"""SciPy's side as a script has the equations of the plant that it is compared with."""

import sys
from pathlib import Path

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from speed.scripted import scripted

from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.model.plant import Plant, true_hardware


def test_a_script_has_the_rates_of_the_plant_with_every_effect():
    on = {f"plant.effects.{name}.enabled": True for name in KNEE.catalogue}
    parameters = load({**on, "leg.person.present": True})
    assembly = assemble(true_hardware(parameters))
    rates = ca.Function("rates", [assembly.x, assembly.u], [assembly.rates])
    script, rng, rest = scripted(rates), np.random.default_rng(1), Plant(parameters).state
    for k in range(20):
        x = rest * rng.normal(1.0, 0.1, len(rest)) + rng.normal(0.0, 1e-4, len(rest))
        u = [*rng.normal(5.0, 1.0, 2), 0.3, 0.1 * k]
        true = np.array(rates(x, u)).ravel()
        np.testing.assert_allclose(script(x.tolist(), u), true, rtol=1e-9, atol=1e-12 * np.abs(true).max())
