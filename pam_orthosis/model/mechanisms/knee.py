# SPDX-License-Identifier: Apache-2.0
"""The orthosis' knee between two muscles whose chain turns a sprocket, the ankle on its linear bearing."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.base import ROTATION, Coordinate, Mechanics, stop_effort
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals


@dataclass(frozen=True)
class Knee:
    """The knee of Eqs. (24)-(27), moved by an extensor and a flexor.

    `mechanics` is (angle, velocity, leg, extra foot mass) -> terms of Eq. (26): the gap workflow gives
    tabulated ones.
    """

    kind: ClassVar[str] = "knee"
    coordinate: ClassVar[Coordinate] = ROTATION
    inputs: ClassVar[tuple[str, ...]] = ("external_torque",)
    stops: ClassVar[tuple[str, ...]] = ("joint.minimum", "joint.maximum")
    live: ClassVar[tuple[str, ...]] = ("leg.person.mass",)
    rows: ClassVar[tuple[str, ...]] = (
        *leg.ROWS, "scenario.start_angle", "plant.mounting.", "plant.deviation.extensor_force",
        "plant.deviation.flexor_force",
    )  # fmt: skip
    parameters: Section
    mechanics: Callable[..., Mechanics] = leg.mechanics

    @property
    def locked(self) -> bool:
        """Whether the joint is locked."""
        return bool(self.parameters.joint.locked)

    @property
    def idle(self) -> Mapping[str, str]:
        """The mass of a person who is not there."""
        return leg.idle(self.parameters)

    @property
    def limits(self) -> tuple[Expression, Expression]:
        """The stops of the joint, rad."""
        return self.parameters.joint.minimum, self.parameters.joint.maximum

    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return the terms of Eq. (26) with a mass at the foot, kg."""
        return self.mechanics(q, velocity, self.parameters, extra_mass)

    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contractions of extensor and flexor, m."""
        return leg.contractions(q, self.parameters)

    def effort(self, s: Signals) -> Expression:
        """Return the torque in the direction of flexion, N m."""
        extensor, flexor = s.actuators.values()
        torque = leg.knee_torque(extensor.tension, flexor.tension, self.parameters)
        torque += stop_effort(s.coordinate, s.velocity, self.parameters.joint)
        return torque + s.external["external_torque"]
