# SPDX-License-Identifier: Apache-2.0
"""One chamber of a pneumatic cylinder; two of them make a double-acting one."""

from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.rows import Field, Section

FIELDS = (
    Field("area", "m^2", 1.0e-6, 1.0, "area of the piston in this chamber"),
    Field("volume", "m^3", 1.0e-8, 1.0, "volume of the chamber at the stroke zero, without its hose"),
    Field("damping", "N s/m", 0.0, 1.0e5, "viscous friction of the piston's seals", 0.0),
    Field("length", "m", 1.0e-3, 10.0, "length of the stroke"),
)


def actuator(m: Section) -> Actuator:
    """Return the chamber: force and volume grow with the area, whatever the stroke."""
    return Actuator(
        force=lambda _stroke, gauge: m.area * gauge,
        volume=lambda stroke, _gauge: m.volume + m.area * stroke,
        damping=m.damping,
        length=m.length,
        pulls_only=False,
        affine=lambda _stroke: (m.area, 0.0),
    )
