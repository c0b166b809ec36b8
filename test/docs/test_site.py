# SPDX-License-Identifier: Apache-2.0
"""The site builds without a warning, needs no network, and reads well on a small screen."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "test" / "report"))

from browser import opened, started  # noqa: E402

NARROW = 400
BY_HAND = sorted((ROOT / "docs").rglob("*.md"))
SEEN = [
    *(str(page.relative_to(ROOT / "docs").with_suffix(".html")) for page in BY_HAND),
    "reference/cli.html",
    "reference/effects/index.html",
    "reference/effects/joint_friction.html",
    "reference/nodes/position_controller.html",
    "reference/parameters/plant.html",
    "reference/scenarios.html",
    "reference/equations.html",
    "reference/machine-file.html",
]

KEY_UP_AND_LOOK = """() => {
    document.querySelector(".md-search__input").dispatchEvent(new KeyboardEvent("keyup", {bubbles: true}));
    return document.querySelector(".md-search-result__link");
}"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("material", reason="mkdocs-material is not installed")
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr
    return folder


@pytest.fixture(scope="module")
def browser():
    with started() as one:
        yield one


def test_generated_pages_are_in_the_site_and_not_in_the_source(site):
    assert (site / "reference" / "effects" / "backlash.html").exists()
    assert not (ROOT / "docs" / "reference" / "effects").exists()
    assert not list(site.rglob("*.py"))
    assert not list(site.rglob("shown"))


def test_no_page_shows_the_name_of_a_file_in_place_of_what_it_holds(site):
    texts = {page.name: re.sub("<[^>]+>", "", page.read_text()) for page in site.rglob("*.html")}
    assert [name for name, text in texts.items() if re.search(r"--8\s*&lt;", text)] == []


def test_every_generated_table_is_in_its_page(site):
    wanted = {
        page: re.findall(r"^<!-- table: ([\w-]+) -->$", page.read_text(encoding="utf-8"), flags=re.M)
        for page in BY_HAND
    }
    assert sum(map(len, wanted.values())) > 10
    for page, tables in wanted.items():
        html = (site / page.relative_to(ROOT / "docs").with_suffix(".html")).read_text(encoding="utf-8")
        assert html.count("<table>") >= len(tables)
        assert "<!-- table" not in html


def test_no_page_needs_the_network_or_is_wider_than_a_small_screen(site, browser):
    asked = set()
    with opened(browser, site / "index.html", width=NARROW) as (page, heard):
        for name in SEEN:
            page.goto((site / name).as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= NARROW, name
        asked |= {line for line in heard if not line.startswith(("request: file:", "request: data:"))}
    assert not {line for line in asked if not line.startswith("request: blob:")}


def test_a_wide_table_scrolls_inside(site, browser):
    with opened(browser, site / "reference" / "topics.html", width=NARROW) as (page, _):
        box = page.locator(".md-typeset__scrollwrap").first
        inner, outer = box.evaluate("e => [e.scrollWidth, e.clientWidth]")
        assert inner > outer
        assert outer <= NARROW
        assert box.evaluate("e => getComputedStyle(e).overflowX") == "auto"


def test_the_search_works_from_a_folder(site, browser):
    with opened(browser, site / "index.html") as (page, _):
        page.locator(".md-search__input").fill("backlash")
        page.wait_for_function(KEY_UP_AND_LOOK, polling=500)  # text alone is not seen once the index is there
        found = page.locator(".md-search-result__link").evaluate_all("all => all.map(e => e.href)")
    assert any("effects/backlash.html" in link for link in found)


def test_there_is_a_dark_mode(site, browser):
    with opened(browser, site / "index.html") as (page, _):

        def ground():
            return page.evaluate("getComputedStyle(document.body).backgroundColor")

        light = ground()
        page.locator("label[title='Dark mode']").click()
        assert page.evaluate("document.body.dataset.mdColorScheme") == "slate"
        assert ground() != light
