# SPDX-License-Identifier: Apache-2.0
"""Write the generated blocks of README.md and of pages; `--check` only says whether they are out of date."""

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from textwrap import fill

from generators.conclusions import conclusions
from generators.results import tracking

from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.check import describe

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"<!-- ([\w :-]+) -->\n.*?<!-- /\1 -->", flags=re.S)
DOCS = ROOT / "docs"
WIDTH = 120
GAP_LINES = ("channel", "angle", "effect", "these data do not", "EXPLAINED")
FILLED = (ROOT / "README.md", *sorted((DOCS / "results").glob("*.md")))


def verdict() -> str:
    """Return what `check` prints of the reference bag."""
    return f"```\n{describe(judge(ROOT / 'bags' / 'walk'))}\n```"


def gap() -> str:
    """Return the lines of the gap tutorial's answer that say most."""
    answer = (DOCS / "shown" / "gap.txt").read_text(encoding="utf-8").splitlines()
    rows = [line for line in answer if line.startswith(GAP_LINES)]
    return "\n".join(["```", *(line.split(", stribeck")[0] for line in rows), "```"])


def blocks() -> dict[str, str]:
    """Return the blocks by name."""
    made = {"verdict": verdict(), "gap": gap(), "results": tracking().strip()}
    for name, words in conclusions().items():
        made[f"in short: {name}"] = f"\n{fill(f'**In short.** {words}', WIDTH)}\n"
    return made


def filled(text: str, made: Mapping[str, str]) -> str:
    """Return the text with each block between its two markers made anew."""
    return BLOCK.sub(lambda found: f"<!-- {found[1]} -->\n{made[found[1]]}\n<!-- /{found[1]} -->", text)


def main() -> int:
    """Fill the blocks; or only report whether that would change them."""
    made, late = blocks(), []
    for file in FILLED:
        text = file.read_text(encoding="utf-8")
        if (new := filled(text, made)) != text:
            late.append(file)
            if "--check" not in sys.argv:
                file.write_text(new, encoding="utf-8")
    for file in late:
        print(f"{file.relative_to(ROOT)} is out of date")
    return int(bool(late) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
