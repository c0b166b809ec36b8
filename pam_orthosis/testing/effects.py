# SPDX-License-Identifier: Apache-2.0
"""What can be hidden: the catalogue's effects in another form, and effects outside the catalogue."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

PUSHES, WANDER = "torque", "wander"  # torques over time, others in each recording
SIZES = ("small", "medium", "large")


@dataclasses.dataclass(frozen=True)
class HiddenEffect:
    """One effect of the hidden plant.

    Attributes:
        name: the catalogue's name, which a workflow has to find.
        parameter: the catalogue's parameter that is its size.
        field: the field of `quantities.Hidden` (or the misfit) that holds the size.
        sizes: small, medium, large, in the parameter's unit (for `around_one`: its distance from 1).
        form: the form in which the hidden plant has it.
        signed: the sign is drawn.
        around_one: the parameter is a factor; the size is its distance from 1.
        same_form: the catalogue's equation is exactly this one, so that intervals can be judged.
        others: further parameters of the catalogue's effect that are true of it, name -> value.
    """

    name: str
    parameter: str
    field: str
    sizes: tuple[float, float, float]
    form: str
    signed: bool = False
    around_one: bool = False
    same_form: bool = False
    others: Mapping[str, float] = dataclasses.field(default_factory=dict)


def _both(
    name: str, parameter: str, stem: str, sizes: tuple[float, float, float], form: str, **more: Any
) -> list[HiddenEffect]:
    return [
        HiddenEffect(f"{muscle}_{name}", parameter, f"{stem}_{muscle[0]}", sizes, form, **more)
        for muscle in ("extensor", "flexor")
    ]


_ALL = [
    HiddenEffect("joint_friction", "coulomb", "coulomb", (0.1, 0.4, 1.5), "LuGre bristles",
                 others={"stribeck": 0.2}),
    HiddenEffect("viscous_friction", "viscosity", "viscosity", (0.05, 0.2, 0.8), "linear", same_form=True),
    HiddenEffect("muscle_hysteresis", "half_width", "hysteresis", (3.0, 10.0, 40.0), "Maxwell-slip elements"),
    HiddenEffect("pressure_dependent_damping", "damping", "pressure_damping", (150.0, 400.0, 900.0),
                 "linear", same_form=True),
    HiddenEffect("direction_dependent_damping", "asymmetry", "direction_damping", (100.0, 300.0, 800.0),
                 "kink at standstill instead of a rounding", signed=True),
    HiddenEffect("creep", "stiffness", "creep", (150.0, 600.0, 2500.0), "two time constants, 0.6 and 1.8 s"),
    HiddenEffect("parallel_elasticity", "stiffness", "elasticity", (0.5, 2.0, 8.0), "hardening spring"),
    HiddenEffect("extra_foot_mass", "mass", "foot_mass", (0.15, 0.5, 2.0), "point mass", same_form=True),
    HiddenEffect("backlash", "half_width", "play", (1.5e-3, 5.0e-3, 1.5e-2), "hard play operator"),
    HiddenEffect("stretch_reflex", "gain", "reflex_gain", (0.15, 0.5, 2.0), "dead time of 40 ms, no lag",
                 others={"threshold": 1.0}),
    HiddenEffect("constant_torque", "torque", "constant_torque", (0.15, 0.5, 2.0), "constant",
                 signed=True, same_form=True),
    HiddenEffect("periodic_torque", "amplitude", "periodic_torque", (0.1, 0.4, 1.5), "with a third harmonic"),
    *_both("force_scale", "scale", "force_scale", (0.05, 0.1, 0.25), "factor",
           signed=True, around_one=True, same_form=True),
    HiddenEffect("valve_dead_band", "half_width", "dead_band", (0.01, 0.05, 0.2), "edges at 1.25 and 0.75"),
    *_both("valve_gain", "gain", "valve_gain", (0.08, 0.15, 0.35), "factor",
           signed=True, around_one=True, same_form=True),
    HiddenEffect("valve_lag", "natural_frequency", "valve_lag", (90.0, 45.0, 25.0), "two first-order lags"),
    HiddenEffect("valve_delay", "delay", "valve_delay", (1.0e-3, 3.0e-3, 8.0e-3), "dead time"),
    *_both("leak", "coefficient", "leak", (1.0e-11, 5.0e-11, 3.0e-10), "orifice"),
    HiddenEffect("hose_resistance", "resistance", "hose", (4.0e5, 1.5e6, 4.0e6), "with a turbulent share"),
    *_both("dead_volume", "volume", "dead_volume", (2.0e-5, 4.0e-5, 9.0e-5), "volume", same_form=True),
    HiddenEffect("polytropic_exponent", "shift", "exponent_shift", (0.06, 0.1, 0.15), "shift",
                 signed=True, same_form=True),
    HiddenEffect("supply_sag", "resistance", "sag", (5.0e6, 2.0e7, 8.0e7), "falls faster than it recovers"),
    HiddenEffect("temperature_drift", "rise", "warming", (10.0, 25.0, 50.0), "two time constants"),
    HiddenEffect("angle_offset", "offset", "angle_offset", (9.0e-3, 1.7e-2, 5.2e-2), "offset",
                 signed=True, same_form=True),
    HiddenEffect("angle_gain", "gain", "angle_gain", (0.01, 0.03, 0.08), "factor",
                 signed=True, around_one=True, same_form=True),
    HiddenEffect("angle_delay", "delay", "angle_delay", (1.0e-3, 3.0e-3, 8.0e-3), "dead time"),
    *_both("pressure_offset", "offset", "pressure_offset", (3.0e3, 8.0e3, 2.5e4), "offset",
           signed=True, same_form=True),
    *_both("pressure_gain", "gain", "pressure_gain", (0.01, 0.03, 0.1), "factor",
           signed=True, around_one=True, same_form=True),
    *_both("pressure_delay", "delay", "pressure_delay", (1.0e-3, 3.0e-3, 8.0e-3), "dead time"),
    HiddenEffect("force_map_misfit", "-", "force_waves", (15.0, 30.0, 60.0), "sines over both coordinates"),
    HiddenEffect("valve_curve_misfit", "-", "valve_waves", (0.06, 0.12, 0.25), "sine over the opening"),
    HiddenEffect("volume_misfit", "-", "volume_waves", (0.04, 0.08, 0.15), "sine over the contraction"),
]  # fmt: skip
EFFECTS = {effect.name: effect for effect in _ALL}

_OUTSIDE = [
    HiddenEffect("cogging_torque", "amplitude", "cogging", (0.2, 0.4, 0.8), "sin 14 q"),
    HiddenEffect("valve_cross_talk", "share", "cross_talk", (0.03, 0.06, 0.12), "opening of the other valve"),
    HiddenEffect("random_pushes", "amplitude", PUSHES, (0.5, 1.2, 2.5), "half sines at random instants"),
    HiddenEffect("drifting_valve_gain", "rise", "gain_drift", (0.06, 0.12, 0.25), "linear in time, extensor"),
    HiddenEffect("sticking_spool", "half_width", "spool_play", (0.02, 0.06, 0.15), "play of the spool, V"),
    HiddenEffect(
        "quadratic_drag", "coefficient", "drag", (0.06, 0.15, 0.4), "grows with the velocity squared"
    ),
    HiddenEffect("detent", "torque", "detent", (0.3, 0.6, 1.2), "bell curve over the angle", signed=True),
    HiddenEffect("jet_torque", "torque", "jet", (2.0, 4.0, 8.0), "proportional to the extensor's opening"),
    HiddenEffect("leak_across", "coefficient", "cross_leak", (5e-11, 1.5e-10, 4e-10), "to the other one"),
    HiddenEffect(
        "wandering_torque", "amplitude", WANDER, (0.3, 0.6, 1.2), "slow waves, others in each recording"
    ),
]
OUTSIDE = {effect.name: effect for effect in _OUTSIDE}

# the sizes above are a knee's: by what those of another machine are larger, by field
_EFFORTS = (
    "coulomb", "constant_torque", "periodic_torque", "cogging", "detent", "jet", "drag", PUSHES, WANDER,
)  # fmt: skip
_FORCES = ("hysteresis", "pressure_damping", "direction_damping", "creep", "force_waves")
SCALED: Mapping[str, str] = {
    **dict.fromkeys(_EFFORTS, "effort"),
    **dict.fromkeys(("viscosity", "elasticity", "reflex_gain"), "effort_per_unit"),
    **dict.fromkeys(("play", "angle_offset"), "unit"),
    **dict.fromkeys(_FORCES, "force"),
    **dict.fromkeys(("dead_volume_e", "dead_volume_f"), "volume"),
    **dict.fromkeys(("leak_e", "leak_f", "cross_leak"), "conductance"),
    **dict.fromkeys(("hose", "sag"), "resistance"),
}
ON_A_LINE = {"joint_friction": "carriage_friction"}


class Scale(NamedTuple):
    """How many times as large as a knee's the efforts, forces, volumes and flows of a machine are."""

    effort: float = 1.0
    effort_per_unit: float = 1.0
    unit: float = 1.0
    force: float = 1.0
    volume: float = 1.0
    conductance: float = 1.0
    resistance: float = 1.0

    def of(self, field: str) -> float:
        """Return the factor of a field of `quantities.Hidden` or of a misfit."""
        return float(getattr(self, SCALED[field])) if field in SCALED else 1.0


def of_machine(table: Mapping[str, HiddenEffect], machine: Machine, scale: Scale) -> dict[str, HiddenEffect]:
    """Return the effects that a machine can have, under its names for them and in its sizes."""
    if machine.kind == "knee":
        return dict(table)
    ends = dict(zip(("extensor_", "flexor_"), machine.names, strict=True))
    found = {}
    for effect in table.values():
        name = ON_A_LINE.get(effect.name, effect.name) if machine.coordinate.unit == "m" else effect.name
        for known, own in ends.items():
            name = f"{own}_{name.removeprefix(known)}" if name.startswith(known) else name
        small, medium, large = (scale.of(effect.field) * size for size in effect.sizes)
        others = effect.others if name == effect.name else {}
        if name in machine.catalogue or table is OUTSIDE:
            sizes = (small, medium, large)
            found[name] = dataclasses.replace(effect, name=name, sizes=sizes, others=others)
    return found
