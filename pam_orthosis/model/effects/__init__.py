# SPDX-License-Identifier: Apache-2.0
"""Catalogue of physical effects: every module of this folder that defines `EFFECTS` adds to it."""

from importlib import import_module
from pkgutil import iter_modules

from pam_orthosis.model.effects.base import Effect


def _collect() -> dict[str, Effect]:
    catalogue: dict[str, Effect] = {}
    for module in sorted(info.name for info in iter_modules(__path__)):
        for effect in getattr(import_module(f"{__name__}.{module}"), "EFFECTS", ()):
            if effect.name in catalogue:
                raise ValueError(f"two effects are named {effect.name}")
            catalogue[effect.name] = effect
    return catalogue


CATALOGUE = _collect()
