# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium for tests, where the machine has one."""

import shutil
from contextlib import contextmanager
from itertools import product

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# no sandbox for root in containers; nothing of the browser's own asks the network
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update"]  # fmt: skip
WIDTHS, SCHEMES, MOST_BYTES = (1280, 400), ("light", "dark"), 2_000_000
GROUNDS = {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 24, 27)"}
# what is drawn for this width is no wider than it
WIDE = "w => innerWidth === w && document.documentElement.scrollWidth <= w"
LOOK = """() => ({
    missing: [...document.querySelectorAll('.plot')].filter(
        e => !e.querySelector('.main-svg .trace') || e.scrollWidth > innerWidth).map(e => e.ariaLabel),
    unnamed: [...document.querySelectorAll('.plot, svg[data-machine], img')].filter(
        e => !(e.getAttribute('aria-label') || e.alt)).length,
    ground: getComputedStyle(document.body).backgroundColor,
})"""
LIMIT_MS = 600_000  # a busy machine takes its time


@contextmanager
def started():
    """Yield a browser; skip if there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=FLAGS, timeout=LIMIT_MS)
        yield browser
        browser.close()


def fits(browser, file, limit_ms=LIMIT_MS):
    """Check a page of ours: offline, quiet, small, named; at each width and scheme drawn without overflow."""
    text = file.read_text(encoding="utf-8")
    assert len(text.encode()) <= MOST_BYTES
    with opened(browser, file) as (page, heard):
        for width, scheme in product(WIDTHS, SCHEMES):
            page.set_viewport_size({"width": width, "height": 1000})
            page.emulate_media(color_scheme=scheme)
            if 'class="plot"' in text:
                page.wait_for_selector("body[data-drawn]")
            page.wait_for_function(WIDE, arg=width, timeout=limit_ms)
            told = page.evaluate(LOOK)
            assert told["missing"] == [], f"{file.name}: not drawn at {width} px, {scheme}"
            assert told["unnamed"] == 0
            assert told["ground"] == GROUNDS[scheme]
        page.wait_for_timeout(50)
        assert [one for one in heard if not one.startswith("trace: ")] == [f"request: {file.as_uri()}"]


@contextmanager
def opened(browser, file, width=1300, height=1000):
    """Yield the page of a file, opened offline, and what the browser complains about or asks for."""
    context = browser.new_context(offline=True, viewport={"width": width, "height": height})
    context.set_default_timeout(LIMIT_MS)
    page, heard = context.new_page(), []
    page.on("console", lambda message: heard.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: heard.append(f"error: {error}"))
    page.on("request", lambda request: heard.append(f"request: {request.url}"))
    page.goto(file.as_uri())
    yield page, heard
    context.close()
