# SPDX-License-Identifier: Apache-2.0
"""Judge the tracking of a bag, from the bag alone, against a bound on the largest error.

The error is reference - measured angle or position. Steady state: its mean size while the reference rests, at
less than 2 % of its peak speed for 0.1 s or more. Observer's velocity lag: delay of the estimated velocity
behind the measured motion, negative if it is ahead. Voltage variation: sum of the changes of a valve voltage
per second. Released: all valves vented, with the reason that the nodes gave; back: within the bound again.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pam_orthosis.bag.tracking import Load, Timing
    from pam_orthosis.bag.verdict import Bound, Verdict


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or .mcap file")
    parser.add_argument(
        "--skip-s", type=not_negative, default=0.0, help="seconds at the start that are not judged (0)"
    )
    parser.add_argument(
        "--partial",
        action="store_true",
        help="judge a run that was cut short or has missing samples",
    )
    parser.add_argument("--namespace", metavar="NS", help="namespace of the leg in the bag (all legs)")
    add_verdict_arguments(parser)


def add_verdict_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `check` and `run` have in common."""
    add_bound_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the verdict as JSON")


def add_bound_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare a bound on the largest error, in the unit in which a machine's errors are shown."""
    group = parser.add_mutually_exclusive_group()
    for unit, of in (("deg", "degrees, for what turns"), ("mm", "for what slides")):
        meaning = f"bound on the largest error, {of} (3); 1,ankle=0.8 gives a joint its own"
        kind = partial(_bound, unit)
        group.add_argument(f"--bound-{unit}", type=kind, dest="bound", metavar=unit.upper(), help=meaning)


def _bound(unit: str, text: str) -> tuple[float, str, dict[str, float]]:
    """Read a bound, and those of joints of their own, such as `1,ankle=0.8`."""
    pairs = [one.rpartition("=") for one in text.split(",")]
    own = {name: not_negative(value) for name, equals, value in pairs if equals}
    whole = [not_negative(value) for _, equals, value in pairs if not equals]
    if len(whole) > 1:
        raise argparse.ArgumentTypeError(f"{text!r} is more than one bound: give 1,ankle=0.8")
    return (whole or [3.0])[0], unit, own


def bound_of(arguments: argparse.Namespace) -> Bound:
    """Return the bound that is given, or the one that holds without."""
    from pam_orthosis.bag.verdict import DEFAULT, Bound

    return Bound(*arguments.bound) if arguments.bound else DEFAULT


def execute(arguments: argparse.Namespace) -> int:
    """Print the verdict; return 0 if the bound holds, 1 if not."""
    from pam_orthosis.bag.verdict import judge_all  # what reads bags takes its time to load

    options = arguments.skip_s, arguments.partial, arguments.namespace
    verdicts = judge_all(arguments.bag, bound_of(arguments), *options)
    return show(verdicts, arguments.json)


def show(verdicts: Mapping[str, Verdict], as_json: bool) -> int:
    """Print the verdict of each leg, by its name; return the exit status."""
    passed = all(verdict.passed for verdict in verdicts.values())
    if as_json:
        legs = {leg: verdict.as_dict() for leg, verdict in verdicts.items()}
        print(json.dumps(legs.get("", {"passed": passed, "legs": legs}), indent=2))
    else:
        print("\n\n".join(titled(leg, describe(verdict)) for leg, verdict in verdicts.items()))
    return 0 if passed else 1


def titled(leg: str, text: str) -> str:
    """Return what is printed on a leg, under its name if it has one."""
    title = f"{leg} leg" if leg in ("left", "right") else leg
    return f"{title}\n{text}" if leg else text


def describe(verdict: Verdict) -> str:
    """Return a verdict as a few lines of text."""
    unit = verdict.unit
    lines = [f"{name:26s} {value:8.3f} {unit}" for name, value, unit in verdict.figures()]
    lines += _timing(verdict.timing) if verdict.timing else []
    lines += [_load(name, load) for name, load in verdict.loads.items()]
    lines += [f"released                   {release}" for release in verdict.releases]
    if verdict.not_led:
        lines.append(f"not judged                 {verdict.not_led} samples: the scenario leaves it free")
    lines += [f"left out                   {remark}" for remark in verdict.remarks]
    if verdict.incomplete:
        lines.append(f"incomplete                 {verdict.incomplete}; `--partial` judges what is there")
    ended = "ended released, " if any(release.lasts for release in verdict.releases) else ""
    lines.append(
        f"{verdict.answer}: {ended}maximum {verdict.max_abs_error:.3f} {unit}, bound {verdict.bound:g}"
        f" {unit}, {verdict.samples} samples in {verdict.duration_s:.3f} s"
    )
    return "\n".join(lines)


def _load(name: str, load: Load) -> str:
    late = (
        "passes half of it at other times" if load.late_ms is None else f"{load.late_ms:.1f} ms off in time"
    )
    answer = "" if load.passed else " (FAILED)"
    return f"{name + ' peak':26s} {load.peak_N:8.3f} N of {load.set_peak_N:.1f} N, {late}{answer}"


def _timing(timing: Timing) -> list[str]:
    late = f"{timing.missed_deadlines} of {timing.periods} ({timing.missed_deadlines / timing.periods:.2%})"
    skipped = f", {timing.skipped_samples} of them not sampled" if timing.skipped_samples else ""
    told = timing.latency_median_ms, timing.latency_p99_ms, timing.latency_max_ms
    answered = None not in told
    latency = (
        "median {:.2f}, 99 % {:.2f}, maximum {:.2f} ms".format(*told) if answered else "no answer recorded"
    )
    return [
        f"latency                    {latency}",
        f"missed deadlines           {late}{skipped}, deadline {timing.deadline_ms:g} ms",
    ]


def not_negative(text: str) -> float:
    """Return a finite number that is not negative, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of 0 or more")
    return value
