# SPDX-License-Identifier: Apache-2.0
"""What in measured data spoils a fit without a sign of it, and what the fit says of the data."""

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.force import ForceModel, fit_force, rms_and_max
from pam_orthosis.identification.groups import LENGTH_GAP, LEVEL_GAP, numbered, points
from pam_orthosis.identification.samples import Samples
from pam_orthosis.model.components.muscle import braid_area, polynomial

# Pa gauge, at which a muscle begins to pull: at nominal length 0 by definition, fits of measured ones give 0
# to 0.5 bar; where the data begin contracted, measured ones need 1.4 bar and more
SLACK_PRESSURE, CONTRACTED_PRESSURE = (-0.35e5, 0.9e5), 0.35e5


def clipped(s: Samples, nominal: float) -> np.ndarray:
    """Return which rows hold the end of the load cell's range: the largest force at different states."""
    top = s.force == s.force.max()
    same = np.ptp(s.pressure[top]) < LEVEL_GAP and np.ptp(s.contraction[top]) < LENGTH_GAP * nominal
    least_clipped = 3  # rows that hold exactly the largest force
    return top if top.sum() >= least_clipped and not same else np.zeros(len(s), bool)


def levelled_off(s: Samples, nominal: float, damping: float, degrees: tuple[int, int]) -> np.ndarray:
    """Return which rows hold the end of the load cell's range, which noise hides from `clipped`.

    They are many more than those just below, and the rest says that the muscle pulls more: a weight that
    hangs on it makes as many rows of one force.
    """
    band, many, large = 0.01, 3, 0.08  # of the largest force; times the rows just below; surely taut
    none, largest = np.zeros(len(s), bool), s.force.max()
    top = s.force > (1 - band) * largest
    below = (s.force > (1 - 2 * band) * largest) & ~top
    states = np.ptp(s.pressure[top]) > LEVEL_GAP or np.ptp(s.contraction[top]) > LENGTH_GAP * nominal
    if not states or top.sum() < many * (1 + below.sum()):
        return none
    rest = s.where(~top & (s.force > large * largest))
    try:
        model = fit_force(rest, damping, degrees).model
    except OrthosisError:  # the rest cannot say it
        return none
    missing = np.median(-model.residual(s.where(top)))
    return top if missing > 2 * rms_and_max(model.residual(rest))[0] + band * largest else none


def copied(s: Samples) -> np.ndarray:
    """Return which rows hold in every column what an earlier one holds: they are no further measurement."""
    table = np.column_stack(list(vars(s).values()))
    _, first = np.unique(table, axis=0, return_index=True)
    copies = np.ones(len(s), bool)
    copies[first] = False
    return copies & (s.serial < 0)  # of samples that follow each other in time none is one


def astray(model: ForceModel, s: Samples) -> str:
    """Return a caution on rows far from what all others say; empty if there are none."""
    far, share = 12.0, 0.1  # times the usual scatter, and of the largest force: no form error is both
    residual = model.residual(s)
    distance = np.abs(residual - np.median(residual))
    usual = 1.4826 * float(np.median(distance))
    rows = np.flatnonzero((distance > far * usual) & (distance > share * s.force.max()))
    if not len(rows):
        return ""
    worst = rows[np.argmax(distance[rows])]
    return (
        f"{len(rows)} of {len(s)} rows lie far from the rest (usually within {usual:.1f} N), most of all"
        f" {s.force[worst]:g} N at {s.pressure[worst] / 1e5:.4g} bar gauge and a contraction of"
        f" {s.contraction[worst] * 1e3:.4g} mm, off by {residual[worst]:.0f} N: check them"
    )


def check_slack_pressure(model: ForceModel, s: Samples, nominal: float) -> str:
    """Return a caution if the muscle would begin to pull at a pressure at which none does; empty if not.

    Raises:
        OrthosisError: and at nominal length even below vacuum.
    """
    first = max(float(s.contraction.min()), 0.0)
    at_rest, at_first = (_slack_pressure(model, x) for x in (0.0, first))
    uncontracted = 0.05  # of the nominal length: data that begin there show what holds at no contraction
    far = first > uncontracted * nominal
    if (far and at_first > CONTRACTED_PRESSURE) or (
        not far and SLACK_PRESSURE[0] < at_rest < SLACK_PRESSURE[1]
    ):
        return ""
    place, pressure = (first, at_first) if far else (0.0, at_rest)
    text = (
        f"at a contraction of {place * 1e3:.3g} mm the fitted muscle begins to pull at {pressure / 1e5:.2f}"
        f" bar gauge (b_0 = {model.b[0]:.4g} N), as no muscle does"
    )
    vacuum = -1.013e5  # Pa gauge
    if at_rest < vacuum:
        raise OrthosisError(
            f"{text}; check --nominal-length-m ({nominal:g} m), and gauge or absolute pressure"
        )
    mixed = "absolute and named gauge" if pressure > 0 and not far else "gauge and named absolute"
    return f"{text}: is the pressure {mixed}, the nominal length not {nominal:g} m, or the force's zero off?"


def check_size(model: ForceModel, s: Samples, nominal: float, diameter: float, angle: float) -> str:
    """Return a caution if the muscle pulls as none of its size does; empty if not.

    Where the data begin, as near to no contraction as they come, the force by the pressure is compared with
    that of an ideal braid.
    """
    usual = (0.55, 1.35)  # measured muscles: 0.7 to 1.1
    x = min(max(float(s.contraction.min()), 0.0), float(s.contraction.max()))
    ideal = braid_area(diameter, angle, x / nominal)
    times = float(polynomial(model.a, x)) / ideal
    if ideal <= 0 or usual[0] < times < usual[1]:
        return ""
    return (
        f"the force grows {times:.3g} times as fast with the pressure as that of a braid of"
        f" {diameter * 1e3:.3g} mm diameter (usual: {usual[0]:g} to {usual[1]:g}): check the units of force"
        " and pressure; a muscle of another size or fibre angle is given by --muscle FILE"
    )


def _slack_pressure(model: ForceModel, contraction: float) -> float:
    """Return the gauge pressure, Pa, at which the fitted muscle begins to pull."""
    area = float(polynomial(model.a, contraction))
    return float(polynomial(model.b, contraction)) / area if area > 0 else 0.0


def check_repeats(s: Samples, nominal: float) -> str:
    """Return a caution if the same points were measured again and no repeat tells it; empty if not."""
    place = points(s.pressure, s.contraction, nominal)
    if place is None or np.ptp(s.repeat):
        return ""
    place = numbered(place, s.direction)
    came = (s.serial < 0) | (np.diff(place, prepend=-1) != 0)  # rows that follow each other are one visit
    times = np.bincount(place[came])
    again, share = times > 1, 0.5  # of all visits, at points that have several
    if times[again].sum() < share * times.sum():
        return ""
    ways = "" if s.direction.any() else ", or direction (1, -1) if they are two ways"
    return (
        f"{again.sum()} points were measured up to {times.max()} times, and no column repeat tells the runs"
        f" apart: the intervals are too narrow; give repeat (number of the run){ways}"
    )


def taut(s: Samples, damping: float, degrees: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Return which rows are of a taut muscle, and what the load cell shows of a slack one, N (0: not seen).

    A slack muscle shows the same small force whatever the pressure, and where it buckles even pushes. Rows of
    large force are fitted; where their model is below zero the muscle is slack, and what the load cell shows
    there is what it shows of every slack row. This is repeated with what is taut by then.
    """
    least_share, start_share = 2.0e-3, 0.08  # of the range: what a taut muscle shows at least; surely shows
    lowest, span = max(float(s.force.min()), 0.0), np.ptp(np.maximum(s.force, 0.0))
    large = s.force >= lowest + start_share * span
    zero: float | None = None
    kept, rounds = large, 20
    for _ in range(rounds):
        try:
            model = fit_force(s.where(kept), damping, degrees).model
        except OrthosisError:  # the fit of what is left will say what is missing
            return s.force >= least_share * s.force.max(), 0.0
        if zero is None:
            zero = _floor(model, s)
        zero, noise = _slack_force(model, s, large, zero)
        before, kept = kept, large | (s.force >= zero + max(least_share * span, 3 * noise))
        if (before == kept).all():
            break
    return kept, zero or 0.0


def _floor(model: ForceModel, s: Samples) -> float:
    """Return at which force, N, the smallest ones level off while the model falls on; 0: at none.

    It is what the load cell shows of a slack muscle. A weight that hangs on one makes rows of one force,
    too, but there the model says that force.
    """
    band, many = 0.003, 3  # of the largest force; times the rows just above
    lowest, width = float(s.force.min()), band * float(s.force.max())
    bottom = s.force < lowest + width
    above = (s.force < lowest + 2 * width) & ~bottom
    if bottom.sum() < many * (1 + above.sum()):
        return 0.0
    off = rms_and_max(model.residual(s.where(~bottom)))[0]
    level = float(np.median(s.force[bottom]))
    return level if np.median(model.residual(s.where(bottom))) > off else 0.0


def _slack_force(model: ForceModel, s: Samples, large: np.ndarray, zero: float) -> tuple[float, float]:
    """Return what the load cell shows of a slack muscle, N: median and scatter; zeros if none is surely so.

    The model is off by hysteresis and form: surely slack is where it is below `zero` by half of that.
    """
    off = rms_and_max(model.residual(s.where(large)))[0]
    shown = s.force[(model.force(s) < zero - off / 2) & ~large]
    least_rows = 3
    if len(shown) < least_rows:
        return 0.0, 0.0
    middle = float(np.median(shown))
    return middle, 1.4826 * float(np.median(np.abs(shown - middle)))


def check_zero(slack: np.ndarray, zero: float, largest: float) -> str:
    """Return a caution if slack rows, N, show nearly one force, and that is not zero; empty if not."""
    share, times = 0.01, 5.0  # of the largest force, and of the slack rows' scatter: a buckled one shows less
    if not len(slack) or abs(zero) < max(share * largest, times * float(np.std(slack))):
        return ""
    return (
        f"the load cell shows {zero:.1f} N of the slack muscle: is its zero off? Subtract it from the force"
    )
