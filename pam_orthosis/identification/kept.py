# SPDX-License-Identifier: Apache-2.0
"""What the data do not identify, and the value that counts in its place."""

from pam_orthosis.identification.data import Data

VOLUME = "volume.v"


def is_scaled(data: Data) -> bool:
    """Return whether the muscle's own file scales the volume."""
    return VOLUME in data.own


def not_identified(data: Data, volume: bool, damping: bool) -> str:
    """Return which of volume and damping was not identified, and what counts then; empty if both were."""
    muscle = data.parameters.at(f"muscle.{data.specimen}")
    fate = "in proportion to length and cross-section" if is_scaled(data) else "stays"
    rest = f"that of {data.specimen} {fate}, {muscle.volume.v[0] * 1e6:.0f} cm3 at rest"
    kept = {f"volume ({rest})": volume, f"damping ({muscle.force.damping:.0f} N s/m stays)": damping}
    missing = [text for text, known in kept.items() if not known]
    return f"not identified: {' and '.join(missing)}" if missing else ""
