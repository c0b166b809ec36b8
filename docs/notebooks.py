# SPDX-License-Identifier: Apache-2.0
"""Run notebooks, each in an empty folder, and keep the outputs: `python docs/notebooks.py [NAME ...]`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent / "notebooks"
SECONDS = 600  # of a cell, on a busy machine


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


def main() -> int:
    """Run those that are named, or all."""
    for file in sorted(FOLDER.glob("*.ipynb")):
        if file.stem in sys.argv[1:] or not sys.argv[1:]:
            nbformat.write(executed(file), file)
            print(file.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
