# SPDX-License-Identifier: Apache-2.0
"""Which muscles can be investigated, by the names of their rows in `config/muscle.yaml`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pam_orthosis.errors import OrthosisError

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

SPECIMENS = ("dmsp_20", "dmsp_10")  # that the shipped test rig has
BRANCH = "muscle."


def specimens_of(machine: Machine) -> tuple[str, ...]:
    """Return the muscles that a machine names, each once; OrthosisError if it has none."""
    branches = dict.fromkeys(one.parameters for one in machine.actuators if one.kind == "muscle")
    if not branches:
        raise OrthosisError(f"{machine.name} has no muscle: there is nothing to identify")
    return tuple(branch.removeprefix(BRANCH) for branch in branches)
