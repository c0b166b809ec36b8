# SPDX-License-Identifier: Apache-2.0
"""Parameters of the emulated hardware: the nominal ones times its deviations. Controllers never read them."""

from collections.abc import Mapping
from typing import Any

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.deviations import deviations_of
from pam_orthosis.model.parameters import Parameters


def true_parameters(parameters: Parameters, branches: tuple[str, ...] = ("",)) -> Parameters:
    """Return the parameters of the emulated hardware: the nominal model times its deviations.

    Args:
        branches: beginnings of the keys that deviate.
    """
    values = parameters.flat()
    true = {
        key: values[key] * values[f"plant.deviation.{name}"]
        for name, keys in deviations_of(values).items()
        for key in keys
        if key.startswith(branches)
    }
    return parameters.substituted(true)


def as_modelled(parameters: Parameters) -> dict[str, Any]:
    """Return the changes that make the emulated hardware its nominal model; the sensors stay noisy."""
    values = parameters.flat()
    changes: dict[str, Any] = {key: 1.0 for key in values if key.startswith("plant.deviation.")}
    changes |= {
        key: False
        for key, value in values.items()
        if key.startswith("plant.effects.") and key.endswith(".enabled") and value
    }
    changes |= {f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "hose_length")}
    return changes | {"plant.delay.valve": values["valve.delay"], "plant.muscle_law": "polynomial"}


def with_nominal(parameters: Parameters, changes: Mapping[str, Any]) -> Parameters:
    """Return the tree with another nominal model; deviations keep the emulated hardware as it is.

    Args:
        changes: dotted key -> value, of the nominal model.

    Raises:
        OrthosisError: unusable values, or a nominal model that no deviation brings to the hardware.
    """
    before, after = parameters.flat(), parameters.changed(changes).flat()
    if own := [key for key in changes if key.startswith("machine.")]:
        raise OrthosisError(f"{own[0]}: the hardware has it from the machine's file too; change it there")
    deviations = {}
    same_factor = 1e-4  # relative difference of two factors that are written with six digits
    for name, keys in deviations_of(before).items():
        if gone := [key for key in keys if before[key] and not after[key]]:
            raise OrthosisError(f"{gone[0]} = 0: no deviation leads from nothing to the hardware's")
        ratios = [before[key] / after[key] for key in keys if after[key]] or [1.0]
        if max(ratios) - min(ratios) > same_factor * max(ratios):
            raise OrthosisError(f"{', '.join(keys)} deviate together: change them by one factor")
        if max(ratios) != 1.0:
            deviations[f"plant.deviation.{name}"] = before[f"plant.deviation.{name}"] * max(ratios)
    return parameters.changed({**changes, **deviations})
