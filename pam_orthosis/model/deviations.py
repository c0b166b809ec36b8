# SPDX-License-Identifier: Apache-2.0
"""By what hardware and nominal model can differ in nuisance parameters: the plant does, fits look for it."""

from collections.abc import Collection

# deviation -> the nominal parameters that it multiplies
DEVIATIONS = {
    "moving_mass": ("leg.thigh.mass", "leg.shank.mass", "leg.knee_mass", "leg.shoe_mass"),
    "person_mass": ("leg.person.mass",),
    "muscle_damping": ("muscle.dmsp_20.force.damping",),
    "small_muscle_damping": ("muscle.dmsp_10.force.damping",),
    "passive_moment": ("leg.ankle.passive_share",),
    "conductance": ("valve.conductance",),
    "critical_ratio": ("valve.critical_ratio",),
    "polytropic_exponent": ("valve.polytropic_exponent",),
    "supply_pressure": ("valve.supply_pressure",),
    "hose_volume": ("valve.hose.volume",),
    "hose_conductance": ("valve.hose.conductance",),
}
GAS = ("conductance", "critical_ratio", "polytropic_exponent", "supply_pressure", "hose_volume")


def deviations_of(keys: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return deviation -> parameters among these keys of a tree, for the deviations that it has."""
    return {
        name: tuple(key for key in of if key in keys)
        for name, of in DEVIATIONS.items()
        if f"plant.deviation.{name}" in keys
    }
