# SPDX-License-Identifier: Apache-2.0
"""Sizes of pages: `python benchmarks/page_sizes.py PAGE.html ... > benchmarks/results/pages.csv`."""

import sys
from pathlib import Path


def main() -> None:
    """Print a row for each page: its name, its size in bytes."""
    print("page,bytes")
    for file in sorted(map(Path, sys.argv[1:])):
        print(f"{file.name},{file.stat().st_size}")


if __name__ == "__main__":
    main()
