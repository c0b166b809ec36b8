# SPDX-License-Identifier: Apache-2.0
"""The live view of a run in a browser: the leg moves, an emergency stop stops, after a reset it walks on."""

import sys
from pathlib import Path

import numpy as np
import pytest
from live_runs import LIMIT_S, QUICK, wait_for

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.parameters import load

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "report"))
from browser import LIMIT_MS, WIDE, WIDTHS, started

FOLLOWS_DEG = 3.0
# of the last samples: the knee moved so far, and the error stayed below
WALKS = f"""from => {{
    const past = legs[""].past.filter(one => one.time > from), measured = past.map(one => one.measured);
    return past.length > 40 && past.at(-1).time - past[0].time > 2
        && Math.max(...measured) - Math.min(...measured) > 30
        && past.every(one => Math.abs(one.error) < {FOLLOWS_DEG});
}}"""
RESIZED = "Too many auto-margin redraws"  # plotly, of a window that changes size while it draws
MOVED = "drawn => document.querySelector('polyline:last-child').getAttribute('points') !== drawn"
FOLLOWED = f'() => Math.abs(legs[""].past.at(-1).error) < {FOLLOWS_DEG}'
VENTED = '() => Object.values(legs[""].past.at(-1).actuators).every(one => one.bar < 1.2)'
NOW = 'legs[""].past.at(-1).time'


@pytest.fixture
def watched(live_run):
    """Return a run and the page of its live view in a browser."""
    run = live_run("--composed", "--watch", *QUICK)
    address = run.process.stderr.readline()
    assert address.startswith("live view: http://127.0.0.1:")
    with started() as browser:
        page = browser.new_page()
        page.set_default_timeout(LIMIT_MS)
        page.heard = []
        page.on("console", lambda message: page.heard.append(message.text))
        page.on("pageerror", lambda error: page.heard.append(str(error)))
        page.goto(address.split()[-1])
        yield run, page


def state(page, name):
    """Wait until the page says what state the run is in."""
    page.wait_for_selector(f"body[data-state={name}]")


def test_it_moves_stops_and_walks_again_after_a_reset(watched):
    run, page = watched
    state(page, "running")
    page.wait_for_function(WALKS, arg=1)
    drawn = page.get_attribute("polyline:last-child", "points")
    page.wait_for_function(MOVED, arg=drawn)
    page.wait_for_selector(".plot .trace path")
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_function(WIDE, arg=width)

    page.click("#stop")
    state(page, "stopped")
    page.wait_for_function(VENTED)
    page.wait_for_selector("#said:has-text('extensor and flexor are vented until reset')")
    page.click("#reset")
    state(page, "running")
    page.wait_for_function(f"() => !({VENTED})()")
    page.wait_for_function(FOLLOWED)
    page.wait_for_function(WALKS, arg=page.evaluate(NOW))

    run.process.terminate()
    state(page, "over")
    assert page.is_disabled("#stop")
    assert run.ended()[0] == 3
    assert [one for one in page.heard if RESIZED not in one] == []
    names = ["extensor_voltage", "flexor_voltage"]
    voltages = [series.value for series in map(read_bag(run.bag, names).__getitem__, names)]
    vents = [value[:-100] == load().valve.minimum_voltage for value in voltages]  # at the end all valves vent
    assert np.logical_and(*vents).sum() > 90


def test_the_view_neither_changes_a_run_nor_outlives_it(run_graph, in_processes):
    done, bag = run_graph("--duration", "1", "--composed", "--watch")
    assert done.returncode == 0, done.stderr
    assert "live view: http://127.0.0.1:" in done.stderr
    names = ["angle", "extensor_voltage"]
    here, there = (read_bag(one, names) for one in (bag, in_processes[1]))
    for name in names:
        assert np.array_equal(here[name].value, there[name].value)


def test_a_run_that_was_killed_takes_its_view_with_it(watched):
    from urllib.error import URLError
    from urllib.request import urlopen

    run, page = watched
    state(page, "running")
    run.process.kill()
    run.process.wait(LIMIT_S)

    def gone():
        try:
            urlopen(page.url, timeout=60).close()
        except (URLError, ConnectionError):
            return True
        return False

    wait_for(gone)
    state(page, "over")
