# SPDX-License-Identifier: Apache-2.0
"""Gate of a change that is to keep every answer: it compares, and its exit status is 1 if anything differs.

python benchmarks/gate.py model --keep FILE       # what this code computes at fixed points, seconds
python benchmarks/gate.py model --against FILE    # the same to the bit; kept on the same machine
python benchmarks/gate.py bags                    # bags/walk and bags/person made anew: the same payloads
python benchmarks/gate.py gap                     # 20 fixed searches: the same verdicts, names and values
python benchmarks/gate.py gap --keep              # writes benchmarks/results/gate.json instead
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # sums over threads differ in their last bits
from mcap.reader import make_reader

ROOT = Path(__file__).resolve().parents[1]
BAGS = {"walk": "default", "person": "person"}  # bag -> scenario
RUN = ("--duration", "7", "--seed", "1", "--composed")
MOST_LINES = 40


def model(arguments: argparse.Namespace) -> list[str]:
    """Return in which numbers the model differs from those kept before, or keep them."""
    os.environ["PAM_ORTHOSIS_NO_COMPILER"] = "1"  # the same operations, without waiting for gcc
    from gate_model import cases, differences

    if arguments.keep:
        arguments.keep.write_text(json.dumps(dict(cases())), encoding="utf-8")
        return []
    return differences(json.loads(arguments.against.read_text(encoding="utf-8")), dict(cases()))


def bags(_arguments: argparse.Namespace) -> list[str]:
    """Return in which topics the reference bags, made anew, differ."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for name, scenario in BAGS.items():
            made = Path(folder, name)
            command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--scenario", scenario, *RUN]
            subprocess.run([*command, "--out", str(made)], check=True, stdout=subprocess.DEVNULL)
            before, after = payloads(ROOT / "bags" / name), payloads(made)
            lines += [f"bags/{name}: {line}" for line in different_topics(before, after)]
    return lines


def payloads(bag: Path) -> dict[str, list[bytes]]:
    """Return topic -> payloads in the order of a bag."""
    found = defaultdict(list)
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                found[channel.topic].append(message.data)
    return found


def different_topics(before: dict[str, list[bytes]], after: dict[str, list[bytes]]) -> list[str]:
    """Return a line on every topic whose payloads are not the same."""
    lines = []
    for topic in sorted(before | after):
        one, other = before.get(topic, []), after.get(topic, [])
        same = sum(a == b for a, b in zip(one, other, strict=False))
        if not same == len(one) == len(other):
            lines.append(f"{topic} has {len(other)} messages, {same} of {len(one)} are the same")
    return lines


def gap(arguments: argparse.Namespace) -> list[str]:
    """Return in which fixed searches the gap workflow finds something else, or keep what it finds."""
    from gate_gap import differences, keep

    return keep() if arguments.keep else differences()


def main() -> int:
    """Parse the command line; return 0 if everything is the same, 1 if not."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    of_model = verbs.add_parser("model").add_mutually_exclusive_group(required=True)
    of_model.add_argument("--keep", type=Path, metavar="FILE", help="write the numbers")
    of_model.add_argument("--against", type=Path, metavar="FILE", help="compare with the numbers of a file")
    verbs.add_parser("bags")
    verbs.add_parser("gap").add_argument("--keep", action="store_true", help="write the answers")
    arguments = parser.parse_args()
    lines = {"model": model, "bags": bags, "gap": gap}[arguments.verb](arguments)
    kept = getattr(arguments, "keep", None)
    print("\n".join(lines[:MOST_LINES]) or f"{arguments.verb}: {'kept' if kept else 'the same'}")
    if len(lines) > MOST_LINES:
        print(f"... {len(lines)} differences")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
