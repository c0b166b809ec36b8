# SPDX-License-Identifier: Apache-2.0
"""What both directions of motion tell apart: hysteresis and creep, which every repeat has alike."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pam_orthosis.bag.tracking import rms
from pam_orthosis.identification.force import ForceModel, fit_force, rms_and_max
from pam_orthosis.identification.groups import numbered
from pam_orthosis.identification.samples import Samples


class Hysteresis(NamedTuple):
    """Force above the other direction's, N: mean over all levels, smallest and largest of a level."""

    mean: float
    low: float
    high: float


def apart(model: ForceModel, s: Samples) -> dict[float, float]:
    """Return level -> force, N, above the other direction's in stretching or venting.

    Damping is accounted for, what remains is friction of the braid and what creeps. Levels of one direction
    are left out.
    """
    residual, direction = model.residual(s), s.direction
    found = {}
    for level in np.unique(s.level).tolist():
        ways = [residual[(s.level == level) & (direction == sign)] for sign in (-1.0, 1.0)]
        if min(map(len, ways)):
            found[level] = float(ways[0].mean() - ways[1].mean())
    return found


def hysteresis(model: ForceModel, s: Samples) -> Hysteresis | None:
    """Return by how much the force lies higher in stretching or venting; None: the data have one way only."""
    found = list(apart(model, s).values())
    return Hysteresis(float(np.mean(found)), min(found), max(found)) if found else None


def check_direction(model: ForceModel, s: Samples, found: Hysteresis | None) -> str:
    """Return a caution if the hysteresis is negative beyond doubt; empty if not."""
    if found is None:
        return ""
    residual, way = model.residual(s), numbered(s.level, s.direction)
    mean = np.bincount(way, residual) / np.bincount(way)
    scatter = rms_and_max(residual - mean[way])[0]
    doubt = 3 * 2 * scatter / len(s) ** 0.5  # three standard errors of a difference between halves
    least = 0.005  # of the largest force
    if -found.mean <= max(doubt, least * s.force.max()):
        return ""
    return (
        f"the hysteresis is negative ({found.mean:.1f} N), but a muscle pulls more while it is stretched or"
        " vented: is the direction reversed?"
    )


def between_directions(model: ForceModel, s: Samples) -> np.ndarray | None:
    """Return how far each coefficient, a then b, may be off to either side; None: the data have one way only.

    It is half the 95 % range of the fits to forces that lie anywhere between both directions. The middle of
    them, which is fitted, is not the force at rest: near a turning point both are on the same side of it.
    """
    parts = 8  # of the contraction: in each the force may lie elsewhere, at all pressures alike
    edges = np.linspace(s.contraction.min(), s.contraction.max(), parts + 1)[1:-1]
    part = np.searchsorted(edges, s.contraction)
    found: dict[float, list[float]] = {}
    for one in np.unique(part):
        for level, both in apart(model, s.where(part == one)).items():
            found.setdefault(level, []).append(both)
    if not found:
        return None
    known = sorted(found)
    half = np.interp(s.level, known, [rms(np.array(found[level])) / 2 for level in known])
    degrees = len(model.a) - 1, len(model.b) - 1
    moved = []
    for one in np.unique(part):  # a fit is linear in the forces
        by = fit_force(replace(s, force=np.where(part == one, half, 0.0)), 0.0, degrees).model
        moved.append(np.concatenate([by.a, by.b]))
    uniform = 3**-0.5  # standard deviation of what lies anywhere within 1 to either side
    return np.asarray(1.96 * uniform * np.sqrt(np.sum(np.square(moved), axis=0)))
