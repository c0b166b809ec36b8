# SPDX-License-Identifier: Apache-2.0
"""Single samples of a channel that jump and are back at once: no mechanism does so, a transmission does.

They are few, and what they do to the noise hides all that is to be found: they are bridged, and said. A pulse
of an input may do so too, where a hose drops pressure: what follows at once upon one is kept.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting.structure import order
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.recordings.ranges import LONGEST, SHARE, TIMES
from pam_orthosis.discrepancy.systems.system import System

BACK = 0.3  # of the jump: by so much at most the samples on both sides differ
ASIDE = 0.5  # of the jump: by so much at least it is beside the lines that come from both sides
DRIVEN = 0.1, 3.0  # of its range, of what all but a hundredth of its steps stay below: an input drives
POSITION = 2  # see `order`
OF_POSITIONS = 0.9  # as `SHARE`, of what moves smoothly: many glitches do not hide themselves
LEAD = 4  # samples after which it may do so


def without_glitches(system: System, one: Recording) -> Recording:
    """Return a recording whose channels have no glitches, with a remark on each that had."""
    signals, remarks = dict(one.signals), list(one.remarks)
    driven = _driven([signals[name] for name in system.inputs if name in signals], one.samples)
    never = np.zeros_like(driven)  # a position cannot leap, whatever drives it
    for channel in system.channels:
        values = signals[channel.name]
        position = order(system, channel.name) >= POSITION
        found = glitches(values, never, OF_POSITIONS) if position else glitches(values, driven)
        if not found.any():
            continue
        places = np.flatnonzero(found)
        kept = np.flatnonzero(~found)
        signals[channel.name] = np.interp(np.arange(len(values)), kept, values[kept])
        most = float(np.abs(values - signals[channel.name]).max())
        remarks.append(
            f"{one.name}: {channel.name} jumps by up to {most:.3g} {channel.unit} and back in {len(places)}"
            f" of {len(values)} samples, the first at {places[0] * one.period:.3f} s: bridged"
        )
    return replace(one, signals=signals, remarks=tuple(remarks))


def _driven(inputs: Sequence[np.ndarray], samples: int) -> np.ndarray:
    """Return which samples (n,) come at once after one at which any input has moved far."""
    moved = np.zeros(samples, dtype=bool)
    for values in inputs:
        steps = np.abs(np.diff(values))
        moved[1:] |= steps > max(DRIVEN[0] * np.ptp(values), DRIVEN[1] * np.quantile(steps, SHARE))
    driven = np.zeros(samples, dtype=bool)
    for lead in range(1, LEAD + 1):
        driven[lead:] |= moved[:-lead]
    return driven


def glitches(values: np.ndarray, driven: np.ndarray, share: float = SHARE) -> np.ndarray:
    """Return which samples (n,) are part of a glitch; none begins where a channel may be driven.

    A glitch is far beyond what a share of the deviations from the neighbours stay below.
    """
    found = np.zeros(len(values), dtype=bool)
    steps = np.abs(np.diff(values))
    if len(values) < LONGEST + 2 or not steps.any():
        return found
    usual = np.quantile(np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:])), share)
    least = TIMES * max(float(usual), float(steps[steps > 0].min()))
    for width in range(1, LONGEST + 1):
        before, after = values[: -width - 1], values[width + 1 :]
        inside = np.lib.stride_tricks.sliding_window_view(values[1:-1], width)
        jumps = inside - 0.5 * (before + after)[:, None]
        jump = np.where((jumps > 0).all(1) | (jumps < 0).all(1), np.abs(jumps).min(1), 0.0)
        back = np.abs(after - before) < BACK * jump
        for start in np.flatnonzero((jump > least) & back & ~driven[1:-width]) + 1:
            if not _turns(values, int(start), width, float(jump[start - 1])):
                found[start : start + width] = True
    return found


def _turns(values: np.ndarray, start: int, width: int, jump: float) -> bool:
    """Return whether a jump is a motion that turns: the lines before and after it lead there, and beyond."""
    outside = 0.5 * (values[start - 1] + values[start + width])
    away = np.sign(values[start] - outside)
    lines = []
    if start >= 2:
        lines.append(values[start] - (2 * values[start - 1] - values[start - 2]))
    if start + width + 1 < len(values):
        lines.append(values[start + width - 1] - (2 * values[start + width] - values[start + width + 1]))
    return any(away * aside < ASIDE * jump for aside in lines)
