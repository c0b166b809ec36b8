# SPDX-License-Identifier: Apache-2.0
"""Pictures of the pages that tutorials write, made by the browser of the tests."""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image, PngImagePlugin

ROOT = Path(__file__).resolve().parents[1]
PICTURES, SHOWN = ROOT / "docs" / "pictures", ROOT / "docs" / "shown"
sys.path.insert(0, str(ROOT / "test" / "report"))

# picture -> page below the folder of a tutorial, file of `shown` that holds its verdict
PAGES = {"report.png": ("report/walk.html", "check.txt"), "gap.png": ("found/gap.html", "gap.txt")}
SIZE = (1100, 900)
KEY = "verdict"  # of the text in a picture


def keep(folder: Path) -> None:
    """Make the pictures of the pages that a folder holds."""
    for name, (page, shown) in PAGES.items():
        if (folder / page).exists():
            draw(folder / page, PICTURES / name, (SHOWN / shown).read_text(encoding="utf-8"))


def draw(page: Path, picture: Path, verdict: str) -> None:
    """Make a picture of a page; it holds the verdict that the page shows."""
    from browser import opened, started

    with started() as browser, opened(browser, page, *SIZE) as (tab, _):
        tab.wait_for_timeout(1500)  # the plots are drawn by scripts
        tab.screenshot(path=picture)
    about = PngImagePlugin.PngInfo()
    about.add_text(KEY, verdict)
    with Image.open(picture) as image:
        small = image.convert("P", palette=Image.Palette.ADAPTIVE, colors=128)
    small.save(picture, pnginfo=about, optimize=True)


def verdict_in(picture: Path) -> str:
    """Return the verdict that a picture holds."""
    with Image.open(picture) as image:
        return image.text[KEY]
