# SPDX-License-Identifier: Apache-2.0
"""Learning from stride to stride, with nothing learned before, on drawn hardware; resumable.

python benchmarks/repetition.py run --out benchmarks/results/repetition.jsonl
python benchmarks/repetition.py table benchmarks/results/repetition.jsonl
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from control_campaign.hardware import drawn

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.repetition import Repetition
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import load, scenario_overrides

SCENARIOS, SAMPLES, STRIDES = ("default", "person"), 10, 10
FULL_SUPPLY = {"plant.deviation.supply_pressure": 1.0}  # what it lacks is no error that repeats


def strides(task: tuple[str, int, bool]) -> dict[str, Any]:
    """Return the RMS error of each stride from the end of the ramp on, deg; the first one knows nothing."""
    scenario, sample, learns = task
    parameters = load({**scenario_overrides(scenario), **drawn(sample), **FULL_SUPPLY})
    plain = make_trajectory(parameters)
    period, length = parameters.scenario.control_period, round(2.0 / parameters.scenario.control_period)
    first = round((parameters.scenario.start_hold + parameters.scenario.start_ramp) / period)
    loop = ClosedLoop(parameters, 1, trajectory=Repetition(plain, parameters) if learns else plain)
    run = loop.run(first + STRIDES * length)
    error = np.degrees(run["reference_angle"] - run["true_angle"])[first:]
    rms = np.sqrt(np.mean(error.reshape(STRIDES, length) ** 2, axis=1))
    return {"scenario": scenario, "sample": sample, "learns": learns, "rms_deg": rms.tolist()}


def table(results: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a Markdown table: of each scenario the worst hardware sample."""
    found = {(one["scenario"], one["sample"], one["learns"]): one["rms_deg"] for one in results}
    yield "| scenario | samples | first without, deg | tenth with, deg | tenth / first | strides worse |"
    yield "|---|---|---|---|---|---|"
    for scenario in SCENARIOS:
        both = [
            (found[scenario, k, False], found[scenario, k, True]) for k in range(SAMPLES + 1)
            if (scenario, k, False) in found and (scenario, k, True) in found
        ]  # fmt: skip
        if not both:
            continue
        worst = max(learned[-1] / plain[0] for plain, learned in both)
        worse = sum(b > a for plain, learned in both for a, b in zip(plain, learned, strict=True))
        firsts, lasts = [plain[0] for plain, _ in both], [learned[-1] for _, learned in both]
        yield (
            f"| {scenario} | {len(both)} | {min(firsts):.2f} .. {max(firsts):.2f}"
            f" | {min(lasts):.2f} .. {max(lasts):.2f} | {worst:.2f} | {worse} |"
        )


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="make the runs that are not in the results file")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--jobs", type=int, default=2)
    verbs.add_parser("table", help="print the table of a results file").add_argument("results", type=Path)
    arguments = parser.parse_args()
    path = arguments.results if arguments.verb == "table" else arguments.out
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    results = [json.loads(line) for line in lines]
    if arguments.verb == "table":
        print("\n".join(table(results)))
        return
    done = {(one["scenario"], one["sample"], one["learns"]) for one in results}
    wanted = [
        (scenario, sample, learns)
        for sample, scenario, learns in product(range(SAMPLES + 1), SCENARIOS, (False, True))
        if (scenario, sample, learns) not in done
    ]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for result in pool.map(strides, wanted):
            with open(path, "a", encoding="utf-8") as stream:
                stream.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
