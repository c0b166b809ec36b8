# SPDX-License-Identifier: Apache-2.0
"""Write the generated blocks of README.md; `--check` only says whether they are out of date."""

import re
import sys
from pathlib import Path

from generators.results import tracking

from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.check import describe

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"


def verdict() -> str:
    """Return what `check` prints of the reference bag."""
    return f"```\n{describe(judge(ROOT / 'bags' / 'walk'))}\n```"


BLOCKS = {"verdict": verdict, "results": lambda: tracking().strip()}


def filled(text: str) -> str:
    """Return the text with each block between its two markers made anew."""
    for name, make in BLOCKS.items():
        pattern = rf"<!-- {name} -->.*?<!-- /{name} -->"
        block = f"<!-- {name} -->\n{make()}\n<!-- /{name} -->"
        text = re.sub(pattern, lambda _, block=block: block, text, flags=re.S)
    return text


def main() -> int:
    """Fill the blocks; or only report whether that would change them."""
    text = README.read_text(encoding="utf-8")
    if filled(text) == text:
        return 0
    print("README.md is out of date")
    if "--check" in sys.argv:
        return 1
    README.write_text(filled(text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
