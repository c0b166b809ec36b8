# SPDX-License-Identifier: Apache-2.0
"""How fast the program is, in ratios to what stands beside it, measured side by side.

    python benchmarks/bench_speed.py run [--only GROUP ...] [--repeats N] --out FILE.json
    python benchmarks/bench_speed.py table FILE.json
    python benchmarks/bench_speed.py curves FILE.json --out PICTURE.png

Groups are measured one after the other, and what a results file held of them before is replaced. A group
that needs a package that is not there says so and is left out: pip install 'pam_orthosis[bench]'.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from speed import GROUPS
from speed.curves import draw
from speed.machine import Load, machine
from speed.rows import as_text
from speed.table import read, table, write


def measured(name: str, repeats: int) -> dict:
    """Measure a group; return what the results file holds of it."""
    load, rows, notes = Load(), [], []
    try:
        for row in import_module(f"speed.{name}").rows(repeats):
            load.look()
            rows.append(asdict(row))
            print(" | ".join(cell for cell in as_text(rows[-1]) if cell), flush=True)
    except ModuleNotFoundError as error:
        notes.append(f"Not measured: {error.name} is not installed (pip install 'pam_orthosis[bench,ros]').")
        print(notes[-1], file=sys.stderr)
    return {
        "meaning": GROUPS[name], "machine": machine(), "load": load.told(), "rows": rows, "notes": notes,
    }  # fmt: skip


def run(names: list[str], repeats: int, out: Path) -> None:
    """Measure groups and put them into the results file, each as soon as it is there."""
    for name in names:
        print(f"{name}: {GROUPS[name]}", file=sys.stderr, flush=True)
        results = read(out) | {name: measured(name, repeats)}
        write(out, {known: results[known] for known in GROUPS if known in results})


def main() -> int:
    """Measure, or print the table of what was measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="measure")
    running.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="groups (all)")
    running.add_argument("--repeats", type=int, default=5, help="of each measurement (5)")
    running.add_argument("--out", type=Path, required=True, metavar="FILE", help="results, JSON")
    drawing = verbs.add_parser("curves", help="draw the curves of the group scaling")
    drawing.add_argument("file", type=Path, metavar="FILE")
    drawing.add_argument("--out", type=Path, required=True, metavar="PNG")
    showing = verbs.add_parser("table", help="print a results file as Markdown")
    showing.add_argument("file", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if arguments.verb == "run":
        run(arguments.only, arguments.repeats, arguments.out)
    elif arguments.verb == "curves":
        draw(read(arguments.file), arguments.out)
    else:
        print(table(read(arguments.file)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
