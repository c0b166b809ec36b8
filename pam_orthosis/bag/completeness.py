# SPDX-License-Identifier: Apache-2.0
"""Whether a bag holds what of a run has to be judged."""

import numpy as np

from pam_orthosis.bag.read import Bag
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError

LONGEST_GAP_NS = SECOND_NS  # without a sample that can be judged, or missing at the end
LEAST_SECONDS = 1.0  # of a run that was cut short, for a verdict on what is there
PERIOD = "scenario.control_period"


def incomplete(bag: Bag, judged: np.ndarray, skip_s: float, lockstep: bool) -> str:
    """Return what of the run cannot be judged though it should be, nothing if all can that matters.

    Judged are stamps (n,), not the seconds that are skipped at the start. In lockstep no sample is left out.
    """
    name = bag.machine.coordinate.name
    there = [bag[one].stamp_ns for one in (name, f"reference_{name}")]
    start = bag[name].stamp_ns[0]
    begin, end = start + round(skip_s * SECOND_NS), max(stamps[-1] for stamps in there)
    planned_s = bag.parameters.get("scenario.duration") if bag.run.get("scenario") else None
    missing_ns = 0 if planned_s is None else start + round(planned_s * SECOND_NS) - end
    if missing_ns > LONGEST_GAP_NS:
        # a reference or a coordinate may go on for a while without the other
        until = (judged[-1] - start) / SECOND_NS
        return f"the bag ends early: it can be judged up to {until:.3f} of {planned_s:g} s"
    edges = np.concatenate([[begin], judged, [end]])
    gap = int(np.argmax(np.diff(edges)))
    if edges[gap + 1] - edges[gap] > LONGEST_GAP_NS:
        since, until = ((edge - start) / SECOND_NS for edge in edges[gap : gap + 2])
        return f"from {since:.3f} to {until:.3f} s {name} and reference share no stamp"
    most = max(np.count_nonzero(stamps >= begin) for stamps in there)
    if len(judged) < most / 2:  # in real time some samples get no answer
        return f"{name} and reference share {len(judged)} of {most} stamps"
    return _lost(bag, judged, skip_s) if lockstep else ""


def _lost(bag: Bag, judged: np.ndarray, skip_s: float) -> str:
    """Return how many samples are missing in a run in lockstep, which begins at 0 and leaves none out."""
    period_s, every = bag.parameters.get(PERIOD), bag.parameters.get("control.position.every", 1)
    first = bag[bag.machine.coordinate.name].stamp_ns[0]
    if not period_s or not bag.run or first > LONGEST_GAP_NS:
        return ""
    begin = first + round(skip_s * SECOND_NS) if skip_s else 0
    period_ns = round(period_s * SECOND_NS)
    due = np.arange(-(-begin // period_ns) * period_ns, judged[-1] + 1, period_ns)
    lost = due[~np.isin(due, judged)]
    if len(lost) < every:
        return ""
    return f"{len(lost)} of {len(due)} samples are missing, the first at {lost[0] / SECOND_NS:.3f} s"


def check_enough(bag: Bag, judged: np.ndarray, incomplete: str) -> None:
    """Raise OrthosisError if too little of a run is there for any verdict."""
    span_s = float(judged[-1] - judged[0]) / SECOND_NS
    told_s = len(judged) * bag.parameters.get(PERIOD, span_s)
    if incomplete and min(span_s, told_s) < LEAST_SECONDS:
        raise OrthosisError(
            f"{bag.path}: {len(judged)} samples in {span_s:.3f} s are too few to judge a run by;"
            f" samples of {LEAST_SECONDS:g} s are needed"
        )
