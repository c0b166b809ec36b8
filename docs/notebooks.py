# SPDX-License-Identifier: Apache-2.0
"""Run notebooks, each in an empty folder, and keep the outputs: `python docs/notebooks.py [NAME ...]`.

With `--check` nothing is kept: it fails where what is printed is not what the notebook shows.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent / "notebooks"
SECONDS = 600  # of a cell, on a busy machine
NUMBER = re.compile(r"-?\d+\.?\d*")
NEAR, SMALL = 0.05, 0.02  # how far printed numbers may be from those that are shown: relative, absolute


def executed(file: Path) -> nbformat.NotebookNode:
    """Return a notebook with outputs of a new kernel in an empty folder."""
    notebook = nbformat.read(file, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=SECONDS, record_timing=False, resources=place).execute()
    return notebook


def texts(notebook: nbformat.NotebookNode) -> list[str]:
    """Return what each cell prints: the kernel may send it in parts."""
    cells = [cell.get("outputs", []) for cell in notebook.cells]
    printed = [[one["text"] for one in outputs if one.get("name") == "stdout"] for outputs in cells]
    return ["".join(parts) for parts in printed if parts]


def same(made: list[str], kept: list[str]) -> bool:
    """Return whether two runs of a notebook print the same words, and numbers that are near."""
    words = [[NUMBER.sub("N", text) for text in run] for run in (made, kept)]
    numbers = [[float(one) for text in run for one in NUMBER.findall(text)] for run in (made, kept)]
    return words[0] == words[1] and all(
        math.isclose(a, b, rel_tol=NEAR, abs_tol=SMALL) for a, b in zip(*numbers, strict=True)
    )


def main() -> int:
    """Run those that are named, or all; return 1 if one prints something else than it shows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--check", action="store_true", help="keep nothing; fail where the outputs differ")
    arguments, failed = parser.parse_args(), 0
    for file in sorted(FOLDER.glob("*.ipynb")):
        if arguments.names and file.stem not in arguments.names:
            continue
        made = executed(file)
        good = not arguments.check or same(texts(made), texts(nbformat.read(file, as_version=4)))
        failed += not good
        if not arguments.check:
            nbformat.write(made, file)
        print(file.name if good else f"{file.name}: prints something else than it shows", flush=True)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
