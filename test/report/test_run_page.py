# SPDX-License-Identifier: Apache-2.0
"""The page of a run: self-contained, true to the bag, and no browser complains about it."""

import base64
import json
import re
import shutil
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from browser import fits, opened, started

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.main import main
from pam_orthosis.model import parameters
from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.report.run_data import MOST_POINTS, read_run, thinned
from pam_orthosis.report.run_page import device_page, run_page
from pam_orthosis.scene.shapes import shape_of

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"


@pytest.fixture(scope="module")
def file(documented):
    status, folder = documented("pam-orthosis report bags/walk --only page --out report")
    assert status == 0
    return folder / "report" / "walk.html"


@pytest.fixture(scope="module")
def browser():
    with started() as one:
        yield one


@pytest.fixture(scope="module")
def page(file):
    return file.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def curves(page):
    """Name -> (x, y) of every curve that the page draws, decoded from the page itself."""
    plots = [json.loads(unescape(text)) for text in re.findall(r'data-plot="([^"]*)"', page)]
    return {t["name"]: (_array(t["x"]), _array(t["y"])) for plot in plots for t in plot["data"]}


def _array(packed):
    return np.frombuffer(base64.b64decode(packed["bdata"]), packed["dtype"])


class References(HTMLParser):
    """Collects what a page refers to."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in ("src", "href", "action", "data")]


def test_the_page_needs_nothing_but_itself(page):
    references = References()
    references.feed(page)
    assert [one for one in references.found if not one.startswith("data:")] == []
    assert "@import" not in page.split("<script", 1)[0]


def test_the_curves_are_the_bags(curves):
    names = ["angle", "reference_angle", "extensor_pressure", "flexor_pressure_reference", "extensor_voltage"]
    bag = read_bag(WALK, [*names, "disturbance"])
    factors = {"angle": 180 / np.pi, "pressure": 1e-5, "voltage": 1.0, "disturbance": 1.0}
    shown = {"angle": "measured", "reference_angle": "reference"}
    for name in (*names, "disturbance"):
        stamps, values = bag[name]
        time, drawn = curves[shown.get(name, name.replace("_", " "))]
        factor = next(f for part, f in factors.items() if part in name)
        assert time == pytest.approx((stamps - bag["angle"].stamp_ns[0]) / 1e9, abs=1e-12)
        assert drawn == pytest.approx(values * factor, rel=1e-12)
    _, (reference, angle) = aligned(bag["reference_angle"], bag["angle"])
    assert curves["error"][1] == pytest.approx(np.degrees(reference - angle), abs=1e-12)


def test_verdict_cycles_and_recording_are_told(page):
    verdict = judge(WALK)
    assert f"{verdict.max_abs_error:.3f} deg" in page
    for cycle in verdict.cycles:
        assert f"<td>{cycle.max_abs_error:.3f}</td><td>{cycle.rms_error:.3f}</td>" in page
    assert "<td>scenario</td><td>default</td>" in page
    assert "scenario.duration" in page


def test_the_bound_is_that_of_the_verdict(tmp_path):
    assert main(["report", str(WALK), "--only", "page", "--bound-deg", "0.5", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "walk.html").read_text()
    assert '<h1>walk: <span class="answer bad">FAILED</span></h1>' in page
    assert "beyond the bound of 0.5 deg" in page


def test_an_incomplete_run_that_holds_its_bound_has_not_failed():
    run, whole = read_run(WALK), judge(WALK)
    verdict = replace(whole, passed=False, incomplete="cut short")
    assert '<h1>walk: <span class="answer bad">INCOMPLETE</span></h1>' in run_page(run, verdict, "")
    told = device_page("both", {}, {"left": verdict, "right": whole}, "")
    assert '<h1>both: <span class="answer bad">INCOMPLETE</span></h1>' in told
    assert "left is incomplete: cut short." in told


def test_thinning_keeps_every_peak():
    time = np.arange(40_000) * 0.002
    value = np.random.default_rng(1).standard_normal(len(time))
    value[12_345], value[34_567] = 50.0, -50.0
    short, kept = thinned(time, value)
    assert len(short) <= MOST_POINTS
    assert (kept.max(), kept.min()) == (50.0, -50.0)
    assert np.all(np.diff(short) > 0)
    assert np.isin(kept, value).all()
    assert len(thinned(time[:100], value[:100])[0]) == 100


def test_the_drawn_leg_is_the_models():
    p = parameters.load()
    angles = np.array([0.0, 0.4, 1.1])
    sketch = shape_of(p).sketch(angles)
    knee, ankle = sketch.body[:, 1], sketch.body[:, 2]
    for i, q in enumerate(angles):
        bodies = leg_model.bodies(q, p.leg)
        assert knee[i] == pytest.approx(bodies[1].position.full().ravel())
        assert ankle[i] == pytest.approx(bodies[3].position.full().ravel())
        for name, contraction in zip(("extensor", "flexor"), leg_model.contractions(q, p.leg), strict=True):
            muscle = sketch.actuators[name]
            length = np.linalg.norm(muscle.lower[i] - muscle.upper[i])
            assert length == pytest.approx(p.muscle.dmsp_20.length - contraction)
            assert np.linalg.norm(muscle.chain[i] - knee[i]) == pytest.approx(p.leg.cogwheel_diameter / 2)


def test_the_extensor_straightens_the_drawn_leg():
    """The chain's pull on the cogwheel, times its lever, turns the shank towards the straight leg."""
    for configuration in (1, -1):
        p = parameters.load({"leg.configuration": configuration})
        sketch = shape_of(p).sketch(np.array([0.8]))
        for name, flexes in (("extensor", -1), ("flexor", 1)):
            muscle = sketch.actuators[name]
            lever, pull = (muscle.chain - sketch.body[:, 1])[0], (muscle.upper - muscle.chain)[0]
            turns = lever[0] * pull[1] - lever[1] * pull[0]  # > 0: from x to z
            assert np.sign(-turns * configuration) == flexes


def test_it_fits_every_screen_and_scheme(browser, file):
    fits(browser, file)


@pytest.mark.parametrize("fault", ["wide", "large", "unnamed", "unsaid", "network"])
def test_a_page_that_does_not_fit_is_noticed(browser, file, page, tmp_path, fault):
    bad = tmp_path / "bad.html"
    faulty = {
        "wide": page.replace("<header>", "<div style='width: 410px; height: 1px'></div><header>"),
        "large": page.replace("<footer>", f"<!--{'x' * 500_000}--><footer>"),
        "unnamed": re.sub('class="plot" role="img" aria-label="[^"]*"', 'class="plot"', page),
        "unsaid": page.replace("<footer>", "<script>console.warn('x')</script><footer>"),
        "network": page.replace("<footer>", "<img alt='x' src='https://example.org/x.png'><footer>"),
    }[fault]
    assert faulty != page
    bad.write_text(faulty, encoding="utf-8")
    with pytest.raises((AssertionError, browser_errors())):
        fits(browser, bad, 2_000)


def browser_errors():
    from playwright.sync_api import TimeoutError as TooLate

    return TooLate


def test_in_a_browser_it_zooms_and_plays(browser, file):
    with opened(browser, file) as (page, _):
        page.wait_for_selector("body[data-drawn]")
        page.evaluate("Plotly.relayout(plots[0], {'xaxis.range[0]': 2, 'xaxis.range[1]': 3})")
        ranges = "plots.map(p => p._fullLayout.xaxis.range.map(x => Math.round(1e6 * x) / 1e6))"
        page.wait_for_function(f"({ranges}).every(([a, b]) => a === 2 && b === 3)")
        body = page.locator("svg[data-machine] polyline").last
        first = body.get_attribute("points")
        page.get_by_text("play").click()
        page.wait_for_function("Number(document.querySelector('input').value) > 40")
        page.get_by_text("pause").click()
        assert body.get_attribute("points") != first
        shown = page.locator("svg[data-machine] text").all_text_contents()
        assert {"hip", "knee", "ankle"} < {word for text in shown for word in text.split()}
        assert page.title() == "walk"


def test_a_page_that_complains_is_noticed(browser, tmp_path):
    bad = tmp_path / "bad.html"
    bad.write_text("<script src='https://example.org/x.js'></script><script>nothing.here()</script>")
    with opened(browser, bad) as (_, heard):
        assert any(re.search("example.org", one) for one in heard)
        assert any(one.startswith("error: ") for one in heard)


def test_reports_of_bags_whose_names_differ_behind_a_point_stand_side_by_side(tmp_path):
    out = tmp_path / "pages"
    for name in ("gain1.5", "gain1.6"):
        shutil.copytree(WALK, tmp_path / name)
        assert main(["report", str(tmp_path / name), "--only", "page", "--out", str(out)]) == 0
    assert main(["report", str(next(WALK.glob("*.mcap"))), "--only", "page", "--out", str(out)]) == 0
    pages = {page.name for page in out.glob("*.html")}
    assert pages == {"gain1.5.html", "gain1.6.html", f"{next(WALK.glob('*.mcap')).stem}.html"}
