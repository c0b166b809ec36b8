# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium for tests, where the machine has one."""

import shutil
from contextlib import contextmanager

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# no sandbox for root in containers; nothing of the browser's own asks the network
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update"]  # fmt: skip
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
