# SPDX-License-Identifier: Apache-2.0
"""What gains of the cascade trade: error, calm voltages, and error with 5 ms more delay; resumable.

    python benchmarks/delay_frontier.py run [--out FILE]
    python benchmarks/delay_frontier.py figure FILE.png [--out FILE]

The default scenario in closed loop without ROS, 9 s, for each observer pole and each gain c1 = c2.
"""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path

from delay_study import delayed, follow, rows

from pam_orthosis.model.parameters import load

OUT = Path(__file__).parent / "results" / "delay_frontier.jsonl"
POLES, GAINS = (60.0, 75.0, 90.0, 105.0, 120.0, 135.0), (28.0, 32.0, 36.0, 39.0, 43.0, 47.0)
SEED = 1
MORE = 5e-3  # s of delay more than nominal


def run(out: Path) -> None:
    """Make the rows that are missing."""
    known = {(row["pole"], row["gain"]) for row in rows(out)}
    late = delayed(load().valve.delay + MORE)
    with out.open("a") as stream:
        for pole, gain in product(POLES, GAINS):
            if (pole, gain) in known:
                continue
            chosen = {"control.observer.pole": pole} | {f"control.position.c{i}": gain for i in (1, 2)}
            followed, delayed_ = follow("default", chosen, SEED), follow("default", {**chosen, **late}, SEED)
            told = {"pole": pole, "gain": gain, **followed, "maximum_later": delayed_["maximum"]}
            stream.write(json.dumps(told) + "\n")
            stream.flush()


def figure(out: Path, file: Path) -> None:
    """Draw the error over the calm, coloured by the error with more delay; the shipped gains marked."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    p, told = load().control, rows(out)
    variation = [max(row["extensor_variation"], row["flexor_variation"]) for row in told]
    late = [min(row["maximum_later"], 4.0) for row in told]
    figure, axes = pyplot.subplots(figsize=(7.5, 4.5), layout="constrained")
    dots = axes.scatter(variation, [row["maximum"] for row in told], c=late, cmap="viridis_r", s=60)
    for row, calm in zip(told, variation, strict=True):
        if (row["pole"], row["gain"]) == (p.observer.pole, p.position.c1):
            axes.scatter([calm], [row["maximum"]], s=200, facecolors="none", edgecolors="black")
            axes.annotate("shipped", (calm, row["maximum"]), (10, 10), textcoords="offset points")
    figure.colorbar(dots, label="maximum error with 5 ms more delay, deg (4: or more)")
    axes.set(xlabel="variation of the valve voltage, V/s", ylabel="maximum error, deg", ylim=(0.6, 1.6))
    axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Run the grid or draw it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("run", help="make the rows that are missing")
    verbs.add_parser("figure", help="draw them").add_argument("file", type=Path)
    for verb in verbs.choices.values():
        verb.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    if given.verb == "run":
        run(given.out)
    else:
        figure(given.out, given.file)


if __name__ == "__main__":
    main()
