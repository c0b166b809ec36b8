# SPDX-License-Identifier: Apache-2.0
"""A sinusoidal torque on the knee."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="periodic_torque",
        stage="torque",
        parameters=(
            Quantity("amplitude", 1.0, "N m", 0.0, 50.0, "amplitude", 0.0),
            Quantity("frequency", 1.3, "Hz", 0.01, 20.0, "frequency"),
            Quantity("phase", 0.0, "rad", -7.0, 7.0, "phase at the time 0", meaningful=(-7.0, 7.0)),
        ),
        expression=lambda s, p, _states: Contribution(
            {"torque": p.amplitude * ca.sin(2 * ca.pi * p.frequency * s.time + p.phase)}
        ),
        physics="A disturbance of one frequency: clonus (5 to 8 Hz), a rocking bed, a helper's hand. The "
        "paper's fig. 8 shows the observer's answer to such a torque.",
        source="paper, fig. 8; magnitude: assumption",
        minimum_effect=0.03,
        starts=tuple({"frequency": f, "phase": phi} for f in (0.4, 0.8, 2.0, 5.0) for phi in (0.0, 1.57)),
        coordinate="time",
        confounded_with=("constant_torque",),
        separated_by=("diagnostic-hold",),
    )
]
