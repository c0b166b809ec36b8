# SPDX-License-Identifier: Apache-2.0
"""A knee orthosis with two antagonistic fluidic muscles, emulated: a library, commands, ROS 2 nodes.

    import pam_orthosis as po

    run = po.simulate(po.parameters("person"))
    print(po.check(run).max_abs_error)

Names of `pam_orthosis.library` are loaded when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pam_orthosis.library import (
        Check,
        Gap,
        Muscle,
        OrthosisError,
        Picture,
        Run,
        Runs,
        check,
        example,
        gap,
        identify,
        machine,
        parameters,
        read,
        simulate,
    )

LIBRARY = "pam_orthosis.library"
__all__ = [
    "Check", "Gap", "Muscle", "OrthosisError", "Picture", "Run", "Runs", "check", "example", "gap",
    "identify", "machine", "parameters", "read", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Return a name of the library."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(LIBRARY), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
