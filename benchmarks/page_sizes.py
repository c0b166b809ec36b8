# SPDX-License-Identifier: Apache-2.0
"""Sizes of pages, and how they look in the browser of the tests.

python benchmarks/page_sizes.py PAGE.html ... [--pictures DIR] > benchmarks/results/pages.csv

The live view is shown beside them, fed with the bag `bags/walk`. A picture is made of each page at each
width, light and dark; a row tells how far the page is wider than the window, which is to be 0.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.live_server import LiveServer
from pam_orthosis.report.live import LiveLeg, inputs, live_page

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test" / "report"))
from browser import LIMIT_MS, SCHEMES, WIDTHS, started  # noqa: E402

SHOWN_S = 5.0  # of the bag in the live view
BEYOND = "document.documentElement.scrollWidth - innerWidth"
DRAWN_MS = 1000  # for plots that are drawn again at another width


def main() -> None:
    """Print a row for each page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--pictures", type=Path, default=None)
    arguments = parser.parse_args()
    print("page,bytes," + ",".join(f"wider than {width} px" for width in WIDTHS))
    with started() as browser, live() as server:
        pages = {file.stem: (file.stat().st_size, file.resolve().as_uri()) for file in arguments.pages}
        pages["live"] = (len(server.page.encode()), server.url)
        for name, (size, address) in sorted(pages.items()):
            beyond = [looked_at(browser, name, address, width, arguments.pictures) for width in WIDTHS]
            print(name, size, *beyond, sep=",", flush=True)


def looked_at(browser: Any, name: str, address: str, width: int, pictures: Path | None) -> int:
    """Make pictures of a page, if wanted; return how many pixels of its width are out of sight."""
    page, beyond = browser.new_page(viewport={"width": width, "height": 1000}), 0
    page.set_default_timeout(LIMIT_MS)
    page.goto(address)
    for scheme in SCHEMES:
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(DRAWN_MS)
        beyond = max(beyond, page.evaluate(BEYOND))
        if pictures:
            page.screenshot(path=pictures / f"{name}-{width}-{scheme}.png", full_page=True)
    page.close()
    return beyond


@contextmanager
def live() -> Iterator[LiveServer]:
    """Yield the live view of a bag that is played to some instant."""
    leg, signals = LiveLeg(load()), Topics(KNEE).signals
    named = {
        one.topic: next(name for name, of in signals.items() if of.topic == one.topic) for one in inputs(KNEE)
    }
    bag = read_bag(ROOT / "bags" / "walk", list(named.values()))
    said = sorted(
        (at, topic, value) for topic, name in named.items() for at, value in zip(*bag[name], strict=True)
    )
    pictures = [leg.add(topic, at, value) for at, topic, value in said if at < SHOWN_S * 1e9 and leg.due(at)]
    server = LiveServer(live_page(leg, [""]), {})
    server.say({"state": "running", "legs": {"": [one for one in pictures if one]}})
    yield server
    server.close()


if __name__ == "__main__":
    main()
