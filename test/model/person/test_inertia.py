# SPDX-License-Identifier: Apache-2.0
"""The person's segments as frustum and cylinder, against integration by slices."""

import numpy as np
import pytest

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.parameters import load
from pam_orthosis.report.paper import drawings, inertia


def sliced(proximal, distal, length, density):
    """Return mass, centre from the proximal end / length, transverse moment about it, by thin discs."""
    z = (np.arange(200_000) + 0.5) * length / 200_000
    r = proximal + (distal - proximal) * z / length
    mass = density * np.pi * r**2 * length / 200_000
    centre = (mass @ z) / mass.sum()
    return mass.sum(), centre / length, float(mass @ (r**2 / 4 + (z - centre) ** 2))


@pytest.mark.parametrize("seed", range(5))
def test_a_frustum_is_found_by_its_mass_and_centre(seed):
    random = np.random.default_rng(seed)
    radii, length = random.uniform(0.03, 0.12, 2), random.uniform(0.3, 0.5)
    density = random.uniform(900, 1200)
    mass, centre, moment = sliced(*radii, length, density)
    found = [float(one) for one in leg.frustum_radii(mass, length, centre, density)]
    assert found == pytest.approx(radii, rel=1e-6)
    assert float(leg.frustum_inertia(mass, length, centre, density)) == pytest.approx(moment, rel=1e-6)


def test_a_centre_in_the_middle_makes_a_cylinder():
    mass, length, density = 3.2, 0.43, 1090.0
    radius = np.sqrt(mass / (np.pi * density * length))
    found = [float(one) for one in leg.frustum_radii(mass, length, 0.5, density)]
    assert found == pytest.approx([radius, radius])
    assert float(leg.frustum_inertia(mass, length, 0.5, density)) == pytest.approx(
        mass * (radius**2 / 4 + length**2 / 12)
    )


def test_the_choice_changes_the_moments_and_keeps_the_mass():
    given = {"leg.person.present": True}
    by = [load({**given, "leg.person.inertia": choice}).leg for choice in ("gyration", "solids")]
    pairs = list(zip(*(leg.bodies(0.5, p) for p in by), strict=True))
    assert all(float(one.mass) == float(other.mass) for one, other in pairs)
    changed = [float(one.inertia) != float(other.inertia) for one, other in pairs]
    assert changed == [name in ("th,p", "sh,p") for name in drawings.BODIES]


def test_the_table_holds_both_and_their_difference():
    rows = {one.quantity: one for one in inertia.compared()}
    shank = rows["shank (cylinder): moment of inertia about its centre"]
    mass, length = 0.0433 * 75.0, 0.2493 * 1.75
    assert shank.gyration == pytest.approx(mass * (0.249 * length) ** 2)
    assert shank.solids / shank.gyration - 1 == pytest.approx(shank.difference)
    assert shank.difference > 0.3  # a cylinder has its mass further out than a calf
