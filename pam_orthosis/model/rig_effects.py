# SPDX-License-Identifier: Apache-2.0
"""Catalogue of effects that the test rig's model can have or lack.

Those of muscles, gas, valves and pressure sensors are the knee's, under the names of the rig: the
investigated muscle (specimen) takes the extensor's place, the MAS-40 (positioner) the flexor's. What
they say is their own; nothing of their equations is written again.
"""

from __future__ import annotations

from dataclasses import replace

from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import Effect, Quantity
from pam_orthosis.model.effects.carriage_friction import RIG_EFFECTS

SIDES = {"extensor": "specimen", "flexor": "positioner"}
SHARED = (
    "muscle_hysteresis", "creep", "pressure_dependent_damping", "direction_dependent_damping",
    "extensor_force_scale", "flexor_force_scale", "extensor_leak", "flexor_leak",
    "extensor_valve_gain", "flexor_valve_gain", "extensor_dead_volume", "flexor_dead_volume",
    "valve_dead_band", "valve_lag", "valve_delay", "hose_resistance", "supply_sag", "polytropic_exponent",
    "extensor_pressure_gain", "flexor_pressure_gain", "extensor_pressure_offset", "flexor_pressure_offset",
    "extensor_pressure_delay", "flexor_pressure_delay",
    "force_map_misfit", "valve_curve_misfit", "volume_misfit",
)  # fmt: skip
# the MAS-40's map errs by 10 to 90 N (polynomial against the geometric law), a DMSP-20's by some newtons
MISFIT_OF_POSITIONER = 10.0


def at_rig(text: str) -> str:
    """Return a name or text with the muscles called as at the rig."""
    for side, name in SIDES.items():
        text = text.replace(side, name)
    return text


class _Renamed:
    """Parameter values under the names that the knee's effect knows them by."""

    def __init__(self, values):
        self._values = values

    def __getattr__(self, name: str):
        return getattr(self._values, at_rig(name))


def _of_rig(effect: Effect) -> Effect:
    advance = effect.advance
    return replace(
        effect,
        name=at_rig(effect.name),
        parameters=tuple(_quantity(effect, q) for q in effect.parameters),
        expression=lambda s, p, states: effect.expression(s, _Renamed(p), states),
        physics=at_rig(effect.physics),
        confounded_with=tuple(n for n in map(at_rig, effect.confounded_with) if n in NAMES),
        separated_by=(),
        coordinate=at_rig(effect.coordinate),
        advance=None if advance is None else lambda p: {at_rig(k): v for k, v in advance(p).items()},
    )


def _quantity(effect: Effect, q: Quantity) -> Quantity:
    named = replace(q, name=at_rig(q.name), meaning=at_rig(q.meaning))
    if effect.name == "force_map_misfit" and q.name.startswith("flexor"):
        sizes = {
            key: MISFIT_OF_POSITIONER * getattr(q, key) for key in ("typical", "minimum", "maximum", "prior")
        }
        return replace(named, **sizes)
    return named


NAMES = {*map(at_rig, SHARED), *RIG_EFFECTS}
RIG_CATALOGUE: dict[str, Effect] = {
    **RIG_EFFECTS,
    **{at_rig(name): _of_rig(CATALOGUE[name]) for name in SHARED},
}
