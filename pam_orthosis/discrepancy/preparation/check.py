# SPDX-License-Identifier: Apache-2.0
"""Stage 1: are these recordings fit for a search, and what can they not show?"""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import welch

from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.recordings.even import CUT
from pam_orthosis.discrepancy.replay.whitening import SEGMENT, noise_levels
from pam_orthosis.discrepancy.systems.boxes import Box
from pam_orthosis.discrepancy.systems.system import Channel, System
from pam_orthosis.errors import OrthosisError

LEAST_SAMPLES = 500
LEAST_LEVELS = 8  # distinct values of a channel that is alive
LEAST_MOTION = 20  # range of a channel over its noise
HELD_SHARE = 0.5  # of samples that repeat the one before in motion: recorded at a lower rate than stamped
WINDOW = 20  # samples, over which motion is looked for
PARTS, FILTERED = 8, 10.0  # of the upper half of the band: power of the largest over the smallest
NOTCH, SEGMENTS = 0.05, 16  # of the usual power, which white noise in so many segments never falls below
COARSE = 0.4  # noise over the step of a signal: that of rounding alone is 0.29
APART = "what was fitted cannot judge: hold out another recording, or none (the last quarters judge then)"
IN_A_ROW = 8  # samples that are compared at once
SEEN = 0.5  # of the different ones of a recording that judges: they are those of a fitted one
STILL = 5  # steps without a change, which noise does not allow
LEAST_CLIPPED = 0.01  # of the samples, that are at one end
BEYOND, LEAST_BEYOND = 0.01, 0.01  # of a box's width, that noise may leave it by; of a recording's samples
NO_NOISE = 1e-7  # noise over the range of a signal


def check(system: System, recordings: Sequence[Recording], warm_up: float) -> list[str]:
    """Return remarks on what the recordings cannot show, each once.

    Raises:
        OrthosisError: a recording is unfit, with the reason.
    """
    remarks: list[str] = []
    for one in recordings:
        _check_length(one, warm_up)
        for channel in system.channels:
            _check_channel(one, channel.name)
        ends = [_saturated(one, channel) for channel in system.channels]
        remarks += [*one.remarks, *_remarks_on_inputs(system, one), *filter(None, ends)]
    return list(dict.fromkeys([*remarks, *_doubts_on_noise(system, recordings)]))


def beyond_boxes(system: System, recordings: Sequence[Recording]) -> list[str]:
    """Return a remark on each side of a muscle's box that recordings leave, by the one that does most."""
    remarks = []
    for box in system.boxes:
        shares = [_beyond(box, one) for one in recordings]
        most = max(shares)
        if most > LEAST_BEYOND:
            low, high = (end * box.report_factor for end in (box.low, box.high))
            ends, worst = f"{low:.4g} to {high:.4g} {box.report_unit}", recordings[shares.index(most)]
            remarks.append(
                f"{box.name} leaves the box of the muscle's map ({ends}) in {most:.0%} of the samples of"
                f" {worst.name}: it is held at the edge there; identify a wider one"
            )
    return remarks


def pulling_alike(system: System) -> list[str]:
    """Return a remark if all of several muscles turn a joint the same way: one of them may be misdeclared."""
    remarks = []
    for values in system.common.values() if len(system.boxes) > 1 else ():
        arms = {key: value for key, value in values.items() if key.endswith(".arm")}
        if len(arms) > 1 and (min(arms.values()) > 0 or max(arms.values()) < 0):
            listed = " and ".join(f"{key} ({value:g})" for key, value in arms.items())
            remarks.append(f"{listed} have the same sign: no muscle pulls against another; is one negative?")
    return remarks


def _beyond(box: Box, one: Recording) -> float:
    """Return the share of a recording's samples that are beyond a box."""
    values, margin = box.quantity(one.signals[box.channel]), BEYOND * (box.high - box.low)
    return float(np.mean((values < box.low - margin) | (values > box.high + margin)))


def unread(recordings: Sequence[Recording]) -> list[str]:
    """Return a remark on the columns of tables that were not read, if there are any."""
    names = ", ".join(dict.fromkeys(name for one in recordings for name in one.unread))
    return [f"columns not read, as they are named like none of the signals: {names}"] if names else []


def _check_length(one: Recording, warm_up: float) -> None:
    least = 2 * warm_up + 1.0
    if one.duration < least:
        raise OrthosisError(
            f"{one.name} lasts {one.duration:.1f} s{_cut(one)}: the search needs {least:.0f} s or more"
            " (gap.replay.warm_up is left out at the start)"
        )
    if one.samples < LEAST_SAMPLES:
        raise OrthosisError(
            f"{one.name} has {one.samples} samples, one every {1e3 * one.period:.3g} ms: the search needs"
            f" {LEAST_SAMPLES} or more; record at a higher rate, or for longer"
        )


def _cut(one: Recording) -> str:
    """Return what was left out of a recording because rows are missing; empty if nothing was."""
    words = next((remark for remark in one.remarks if CUT in remark), "")
    return f" ({words.removeprefix(f'{one.name}: ')})" if words else ""


def check_divisible(recordings: Sequence[Recording], share: float, warm_up: float) -> None:
    """Check that a share of each recording is long enough to judge by.

    Raises:
        OrthosisError: a recording is too short to be divided.
    """
    least = (warm_up + 1.0) / share
    for one in recordings:
        if one.duration < least:
            raise OrthosisError(
                f"{one.name} lasts {one.duration:.1f} s{_cut(one)}: too short to judge by its last"
                f" {share:.0%}; record {least:.0f} s or more, or name another recording with --held-out"
            )


def check_unseen(training: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """Check that no recording holds the samples of another one, whatever its name and its clock.

    What was fitted cannot judge, and a copy would count as a measurement of its own.

    Raises:
        OrthosisError: most samples of one are those of another recording.
    """
    every = [*training, *held_out]
    names = sorted(set.intersection(*(set(one.signals) for one in every)))
    known: dict[tuple[int, int], np.ndarray] = {}

    def of(k: int, step: int = 1) -> np.ndarray:
        if (k, step) not in known:
            known[k, step] = _in_a_row(every[k], names, step)
        return known[k, step]

    for i, one in enumerate(every):
        for j, other in enumerate(every[:i]):
            step = max(1, round(one.period / other.period))
            share = float(np.isin(of(i), of(j, step)).mean())
            if share > SEEN:
                remedy = APART if j < len(training) <= i else "give each recording once"
                raise OrthosisError(
                    f"{one.name}: {share:.0%} of its samples are those of {other.name}; {remedy}"
                )


def _in_a_row(one: Recording, names: Sequence[str], step: int) -> np.ndarray:
    """Return a recording's different sequences of some samples, each as one number of many bytes.

    Coarse readings of two recordings are equal now and then, but not several in a row. In single precision:
    a table may have fewer digits than the bag that it was made of. `step`: of how many samples one counts.
    """
    rows = np.column_stack([one.signals[name] for name in names]).astype(np.float32)
    reach = min((IN_A_ROW - 1) * step + 1, len(rows))
    windows = sliding_window_view(rows, reach, axis=0)[..., ::step]
    flat = np.ascontiguousarray(windows).reshape(len(windows), -1)
    return np.unique(flat.view(np.dtype((np.void, flat.itemsize * flat.shape[1]))))


def check_motion(system: System, recordings: Sequence[Recording], purpose: str) -> None:
    """Check that every channel which an equation predicts moves in one of the recordings at least.

    Noise alone would let nothing be fitted, or veto every effect that was.

    Raises:
        OrthosisError: one rests in all of them; `purpose` says what they are for.
    """
    for name in (name for equation in system.equations for name in equation.channels):
        if not any(_moves(one, name) for one in recordings):
            names = ", ".join(one.name for one in recordings)
            raise OrthosisError(
                f"{names}: {name} does not move beyond {LEAST_MOTION} times"
                f" its noise; {purpose} needs a recording in which it does"
            )


def _moves(one: Recording, name: str) -> bool:
    noise = noise_levels({name: [one.signals[name]]}, [one.period])[name]
    return float(np.ptp(one.signals[name])) > LEAST_MOTION * noise


def missing_inputs(system: System, recordings: Sequence[Recording]) -> list[str]:
    """Return the inputs that some recording does not have."""
    return [name for name in system.inputs if any(name not in one.signals for one in recordings)]


def _check_channel(one: Recording, name: str) -> None:
    values = one.signals[name]
    if len(np.unique(values)) < LEAST_LEVELS:
        raise OrthosisError(
            f"{one.name}: {name} hardly changes ({len(np.unique(values))} values): stuck sensor?"
        )
    repeated = _repeated(values)
    if repeated > HELD_SHARE:
        raise OrthosisError(
            f"{one.name}: {100 * repeated:.0f} % of the samples of {name} repeat the one before in motion; it"
            " was recorded at a lower rate than its stamps say"
        )


def _repeated(values: np.ndarray) -> float:
    """Return the share of repeated samples where the signal moves by its resolution a sample or more.

    Slower, a coarse encoder repeats itself too.
    """
    steps = np.abs(np.diff(values))
    resolution = steps[steps > 0].min()
    moves = np.abs(values[WINDOW:] - values[:-WINDOW]) >= WINDOW * resolution
    repeated = np.convolve(steps == 0, np.ones(WINDOW) / WINDOW, "valid")
    return float(repeated[moves].mean()) if moves.any() else 0.0


def _doubts_on_noise(system: System, recordings: Sequence[Recording]) -> list[str]:
    """Return which channel's noise does not show how well it is measured, each kind of doubt once."""
    found: dict[tuple[str, str], list[str]] = {}
    for one in recordings:
        for channel in system.channels:
            if why := _doubt_on_noise(one, channel.name):
                kind = why[why.rindex("(") :]
                found.setdefault((channel.name, kind), []).append(f"{one.name}: {channel.name} {why}")
    return [
        f"{first}{_in_others(len(more))}; its noise floor is not how well it was measured"
        for first, *more in found.values()
    ]


def _in_others(count: int) -> str:
    return f", in {count} more recording{'s' * (count > 1)} too" if count else ""


def _doubt_on_noise(one: Recording, name: str) -> str:
    """Return why a channel's noise does not show how well it is measured; empty if it does."""
    values = one.signals[name]
    noise = noise_levels({name: [values]}, [one.period])[name]
    density = welch(values, nperseg=min(SEGMENT, len(values)))[1]
    power = [float(np.mean(part)) for part in np.array_split(density[len(density) // 2 : -1], PARTS)]
    steps = np.abs(np.diff(np.unique(values)))
    if noise < NO_NOISE * np.ptp(values):
        return "has no noise (simulated, or smoothed)"
    if max(power) > FILTERED * min(power):
        times = max(power) / min(power)
        return f"has noise whose power varies {times:.0f}-fold in the upper half of its band (filtered, slow)"
    if _is_notched(values):
        return "has noise that lacks single frequencies, as a mean over several samples does (filtered)"
    if noise < COARSE * float(steps.min()):
        return f"has steps {float(steps.min()) / noise:.0f} times its noise (quantised)"
    return ""


def _is_notched(values: np.ndarray) -> bool:
    """Return whether noise hardly has single frequencies in the upper half of its band."""
    density = welch(values, nperseg=min(SEGMENT, len(values) // SEGMENTS))[1]
    upper = density[len(density) // 2 : -1]
    return bool(upper.min() < NOTCH * np.median(upper))


def _saturated(one: Recording, channel: Channel) -> str:
    """Return that a channel seems to end at a value, if noise is seen everywhere but there."""
    values = one.signals[channel.name]
    still = np.convolve(np.diff(values) == 0, np.ones(STILL), "valid") == STILL
    for end in (values.min(), values.max()):
        at_end = still & (values[: len(still)] == end)
        share = float(np.mean(values == end))
        if at_end.any() and share > LEAST_CLIPPED and (still & ~at_end).mean() < LEAST_CLIPPED * share:
            return (
                f"{one.name}: {share:.0%} of the samples of {channel.name} are {end:.6g} {channel.unit}"
                " exactly and none is beyond: does the sensor saturate? The search takes them as they are"
            )
    return ""


def _remarks_on_inputs(system: System, one: Recording) -> list[str]:
    remarks = []
    for name in system.inputs:
        if name in one.left_out:
            continue
        if name not in one.signals:
            beside = [other for other in system.inputs if other in one.signals]
            unused = f", nor what {' and '.join(beside)} drives" if beside else ""
            remarks.append(f"{one.name} has no {name}: what it drives cannot be judged{unused}")
        elif np.ptp(one.signals[name]) == 0:
            remarks.append(f"{one.name}: {name} never changes")
    return remarks
