# SPDX-License-Identifier: Apache-2.0
"""The orthosis' knee between two muscles whose chain turns a sprocket, the ankle on its linear bearing."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.base import Mechanics, stop_effort
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals


@dataclass(frozen=True)
class Knee(leg.LegJoint):
    """The knee of Eqs. (24)-(27), moved by an extensor and a flexor; an effect's mass is at the foot.

    The gap workflow gives it tabulated `mechanics`.
    """

    kind: ClassVar[str] = "knee"
    stops: ClassVar[tuple[str, ...]] = ("joint.minimum", "joint.maximum")
    rows: ClassVar[tuple[str, ...]] = (
        *leg.ROWS, "scenario.start_angle", "plant.mounting.", "plant.deviation.extensor_force",
        "plant.deviation.flexor_force",
    )  # fmt: skip
    mechanics: Callable[..., Mechanics] = leg.mechanics

    @property
    def ends(self) -> Section:
        """The parameters of its soft stops."""
        joint: Section = self.parameters.joint
        return joint

    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contractions of extensor and flexor, m."""
        return leg.contractions(q, self.parameters)

    def effort(self, s: Signals) -> Expression:
        """Return the torque in the direction of flexion, N m."""
        extensor, flexor = s.actuators.values()
        torque = leg.knee_torque(extensor.tension, flexor.tension, self.parameters)
        torque += stop_effort(s.coordinate, s.velocity, self.ends)
        return torque + s.external["external_torque"]
