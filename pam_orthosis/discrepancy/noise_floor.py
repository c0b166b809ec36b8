# SPDX-License-Identifier: Apache-2.0
"""What noise alone would leave in the recordings that judge, and which of their samples chance decides."""

from __future__ import annotations

import numpy as np

from pam_orthosis.discrepancy import measure
from pam_orthosis.discrepancy.beginning import Beginning, bare_replay, residual_noise
from pam_orthosis.discrepancy.expected import Samples, decided, expected_squares
from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.selection import Selection
from pam_orthosis.discrepancy.system import System
from pam_orthosis.model.parameters import Section

WHOLE = 0.995  # share of the samples that are judged, above which none is said to be left out


def final_floor(start: Beginning, found: Selection, settings: Section) -> measure.Gap:
    """Return the noise floor as the final model shows it, in the recordings that judge.

    In a closed loop the inputs answer to the sensors' noise; a model that lacks a delay takes that for
    its own doing, and its residuals tell a wrong level. It is counted from the noise that the whiteners were
    made with, which is the bare model's.
    """
    replay, floor = bare_replay(found.problem.replay), start.floor
    fitted = [one.run for one in found.problem.scored]
    first = residual_noise(replay, fitted, settings, (), replay.defaults(()))
    last = _last_levels(start, found, settings)
    return _scaled(floor, {name: floor.white[name] * last[name] / first[name] for name in first})


def _last_levels(start: Beginning, found: Selection, settings: Section) -> dict[str, float]:
    """Return the noise (sd) of the recordings that judge as the final model's residuals show it."""
    judging = [one.run for one in start.held_out.scored]
    return residual_noise(found.problem.replay, judging, settings, found.final.effects, found.final.values)


def _scaled(floor: measure.Gap, white: dict[str, float]) -> measure.Gap:
    """Return a floor with other whitened levels, units in proportion."""
    units = {name: floor.units[name] * white[name] / floor.white[name] for name in white}
    overall = float(np.sqrt(np.mean([value**2 for value in white.values()])))
    return measure.Gap(units, {**white, measure.OVERALL: overall})


def decided_and_floor(
    start: Beginning, found: Selection, spread: np.ndarray, settings: Section
) -> tuple[Samples | None, measure.Gap]:
    """Return which held-out samples chance does not decide, and what the final model expects to leave there.

    None and the noise floor, if no state of the model is left to chance.
    """
    final, judge = found.final, start.held_out
    if not _chance(found.problem.system, final):
        return None, final_floor(start, found, settings)
    noise, cutoff = _last_levels(start, found, settings), settings.replay.cross_cutoff
    squares = expected_squares(judge, final, spread, noise, cutoff)
    masks = decided(judge, squares)
    if masks is None:
        return None, final_floor(start, found, settings)
    white = {
        name: float(
            np.sqrt(np.mean(np.concatenate([squares[key][masks[key]] for key in squares if key[1] == name])))
        )
        for name in start.floor.units
    }
    return masks, _scaled(start.floor, white)


def remark_on_left_out(masks: Samples | None) -> tuple[str, ...]:
    """Return the remark on samples that do not count."""
    if masks is None:
        return ()
    share = {channel: np.mean(np.concatenate([m for (_, c), m in masks.items() if c == channel]))
             for _, channel in masks}  # fmt: skip
    told = ", ".join(f"{1 - kept:.0%} of {name}" for name, kept in share.items() if kept < WHOLE)
    return (f"not judged, since chance decides where play comes to rest: {told}",) if told else ()


def _chance(system: System, final: Fit) -> bool:
    """Whether a model has a state that chance decides."""
    catalogue = system.bare().catalogue
    return any(catalogue[name].held for name in (*final.effects, *system.simpler))
