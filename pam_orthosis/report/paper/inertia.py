# SPDX-License-Identifier: Apache-2.0
"""The person's thigh and shank as frustum and cylinder, section 3, beside De Leva's radii of gyration."""

from typing import NamedTuple

import casadi as ca

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.parameters import Parameters, load

CHOICE = "leg.person.inertia"
PRESENT = {"leg.person.present": True}
SHAPES = {"thigh": "frustum", "shank": "cylinder"}


class Compared(NamedTuple):
    """One quantity by De Leva's radii of gyration and by homogeneous solids, SI."""

    quantity: str
    unit: str
    gyration: float
    solids: float

    @property
    def difference(self) -> float:
        """By how much the solids give more, as a share."""
        return self.solids / self.gyration - 1


def compared() -> list[Compared]:
    """Return centres and moments of inertia of the segments, and m(q) and G(q) of the knee with a person."""
    by = {choice: _quantities(choice) for choice in ("gyration", "solids")}
    return [Compared(*name, value, by["solids"][name]) for name, value in by["gyration"].items()]


def _quantities(choice: str) -> dict[tuple[str, str], float]:
    p = load({**PRESENT, CHOICE: choice})
    found: dict[tuple[str, str], float] = {}
    for name, length in zip(SHAPES, leg.segment_lengths(p.leg), strict=True):
        segment = getattr(p.leg.person, name)
        centre, inertia = map(float, leg.segment_inertia(segment, p.leg.person, length))
        mass, away = segment.mass_fraction * p.leg.person.mass, centre * length
        what = f"{name} ({SHAPES[name]})"
        found[f"{what}: centre from its upper end", "m"] = away
        found[f"{what}: moment of inertia about its centre", "kg m^2"] = inertia
        found[f"{what}: the same about its upper end", "kg m^2"] = inertia + mass * away**2
    found |= _of_knee(p)
    return found


def _of_knee(p: Parameters) -> dict[tuple[str, str], float]:
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    terms = leg.mechanics(q, velocity, p.leg)
    function = ca.Function("terms", [q], [terms.inertia, terms.gravity])
    found: dict[tuple[str, str], float] = {}
    for pose in (0.3, 1.1):
        inertia, gravity = map(float, function(pose))
        found[f"m(q) of the knee at q = {pose:g} rad", "kg m^2"] = inertia
        found[f"G(q) of the knee at q = {pose:g} rad", "N m"] = gravity
    return found
