# SPDX-License-Identifier: Apache-2.0
"""The results file, group by group, and the table made of it."""

from __future__ import annotations

import json
from pathlib import Path

from speed.rows import as_text

HEAD = ("what", "ours", "beside it", "ratio", "range", "repeats", "goal", "met")


def read(path: Path) -> dict[str, dict]:
    """Return group -> machine, load, rows, notes of a results file; nothing if there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def write(path: Path, results: dict[str, dict]) -> None:
    """Write a results file."""
    path.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


def table(results: dict[str, dict]) -> str:
    """Return all groups as Markdown."""
    return "\n\n".join(_group(name, told) for name, told in results.items())


def _group(name: str, told: dict) -> str:
    lines = [f"### {name}: {told['meaning']}", "", f"{told['machine']}; {_busy(told['load'])}.", ""]
    lines += [f"- {note}" for note in told["notes"]]
    if told["notes"]:
        lines.append("")
    if told["rows"]:
        lines += [_line(HEAD), _line(["---"] * len(HEAD)), *(_line(as_text(row)) for row in told["rows"])]
    return "\n".join(lines).rstrip()


def _busy(load: dict) -> str:
    busy = f"others kept {load['cores_used_by_others']:.1f} cores busy meanwhile"
    if "median_pace_ms" not in load:  # of an older table
        return busy
    shortest, middle, longest = (load[f"{which}_pace_ms"] for which in ("shortest", "median", "longest"))
    loop = f"a loop that is always the same took {shortest:g} to {longest:g} ms, {middle:g} in the median"
    return f"{busy}; {loop}"


def _line(cells) -> str:
    return f"| {' | '.join(cells)} |"
