# SPDX-License-Identifier: Apache-2.0
"""Misfit of the muscles' volumes: a relative error, cubic in contraction, linear in pressure."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

WHOLE_PRESSURE = 6.0e5  # Pa gauge
WHOLE_STROKE = 0.25  # relative contraction


def _expression(s, p, _states):
    """The volume and its two derivatives stay consistent."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")  # contraction and pressure, -1 to 1
    added = {}
    for m in ("extensor", "flexor"):
        by_x = 2 / (WHOLE_STROKE * getattr(s, f"{m}_length"))
        by_y = 2 / WHOLE_PRESSURE
        here = [by_x * getattr(s, f"{m}_contraction") - 1, by_y * getattr(s, f"{m}_gauge") - 1]
        constant, along_x, bend, turn, along_y = (getattr(p, f"{m}_{name}") for name in TERMS)
        error = constant + along_x * x + bend * (2 * x**2 - 1) + turn * (4 * x**3 - 3 * x) + along_y * y
        all_of_it = [error, by_x * ca.gradient(error, x), by_y * ca.gradient(error, y)]
        error, by_contraction, by_pressure = ca.substitute(all_of_it, [x, y], here)
        volume = getattr(s, f"{m}_volume")
        added[f"{m}_volume"] = error * volume
        added[f"{m}_volume_by_contraction"] = (
            error * getattr(s, f"{m}_volume_by_contraction") + by_contraction * volume
        )
        added[f"{m}_volume_by_pressure"] = (
            error * getattr(s, f"{m}_volume_by_pressure") + by_pressure * volume
        )
    return Contribution(added)


TERMS = {
    "c0": "constant part",
    "cx": "part that grows with the contraction",
    "cxx": "part that bends with the contraction",
    "cxxx": "part that bends twice",
    "cp": "part that grows with the pressure",
}

EFFECTS = [
    Effect(
        name="volume_misfit",
        stage="gas",
        parameters=tuple(
            Quantity(
                f"{m}_{k}",
                0.015,
                "-",
                -0.3,
                0.3,
                f"{m}: relative error of the volume, {text}",
                0.0,
                prior=0.015,
            )
            for m in ("extensor", "flexor")
            for k, text in TERMS.items()
        ),
        expression=_expression,
        physics="The cylinder with two frustums of Eq. (15) is not a muscle's true shape; its volume is off "
        "by a per cent or two, differently for a short and a long, a soft and a hard muscle.",
        source="conical ends: 5 to 12 % of the braid's volume at high contraction, known to a fifth of that",
        minimum_effect=0.005,
        coordinate="extensor_contraction",
        confounded_with=("extensor_dead_volume", "flexor_dead_volume", "polytropic_exponent"),
        separated_by=("diagnostic-locked",),
        shape=True,
    )
]
