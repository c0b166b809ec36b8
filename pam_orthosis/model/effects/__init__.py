# SPDX-License-Identifier: Apache-2.0
"""Physical effects by kind: every module of this folder that defines `EFFECTS` adds to them."""

from importlib import import_module
from pkgutil import iter_modules

from pam_orthosis.model.effects.base import Effect

_MODULES = (import_module(f"{__name__}.{info.name}") for info in iter_modules(__path__))
KINDS: tuple[Effect, ...] = tuple(
    sorted((one for module in _MODULES for one in getattr(module, "EFFECTS", ())), key=lambda one: one.kind)
)
