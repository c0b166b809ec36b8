# SPDX-License-Identifier: Apache-2.0
"""What actuators move: one coordinate with its inertia, contractions, forces and stops."""

from pam_orthosis.model.mechanisms.ankle import Ankle
from pam_orthosis.model.mechanisms.base import Mechanism
from pam_orthosis.model.mechanisms.carriage import Carriage
from pam_orthosis.model.mechanisms.knee import Knee
from pam_orthosis.model.mechanisms.one_axis import Rotation, Sole, Translation

__all__ = ["MECHANISMS", "Ankle", "Carriage", "Knee", "Rotation", "Sole", "Translation"]
MECHANISMS: dict[str, type[Mechanism]] = {
    one.kind: one for one in (Knee, Ankle, Carriage, Rotation, Sole, Translation)
}


def all_rows() -> set[str]:
    """Return how the keys of `config/` begin that only machines of some mechanisms have."""
    return {row for one in MECHANISMS.values() for row in one.rows}
