# SPDX-License-Identifier: Apache-2.0
"""The table of speeds: ratios of figures taken side by side, goals, groups that lack a package."""

import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import bench_speed
from speed import GROUPS, rows, table

ROOT = Path(__file__).resolve().parents[2]


def test_a_row_tells_the_median_of_the_ratios_of_what_was_measured_side_by_side():
    one = rows.row(
        "g", "w", "us", [2.0, 30.0, 3.0], [1.0, 10.0, 2.0], rows.Goal("at most 2 times", at_most=2.0)
    )
    assert (one.ours, one.other, one.ratio) == (3.0, 2.0, 2.0)
    assert one.met is True
    assert one.spread == (1.5, 3.0)
    assert one.repeats == 3


def test_a_goal_without_a_peer_is_for_our_own_figure():
    slow = rows.row("g", "w", "x real time", [0.9, 0.8, 1.2], goal=rows.Goal("real time", at_least=1.0))
    assert (slow.other, slow.ratio, slow.met) == (None, None, False)
    assert rows.row("g", "w", "s", [1.0]).met is None


def test_measurements_alternate():
    order = []
    figures = rows.alternating(2, lambda: order.append("a") or 1.0, lambda: order.append("b") or 2.0)
    assert order == ["a", "b", "a", "b"]
    assert figures == [[1.0, 1.0], [2.0, 2.0]]


def test_a_group_without_its_package_says_so_and_the_others_go_on(tmp_path, monkeypatch):
    def lacking(_repeats):
        raise ModuleNotFoundError("no", name="mujoco")
        yield

    def there(repeats):
        yield rows.row("b", "a thing", "us", [1.0] * repeats, [2.0] * repeats)

    groups = {"a": lacking, "b": there}
    for name, made in groups.items():
        monkeypatch.setitem(GROUPS, name, f"group {name}")
        monkeypatch.setitem(sys.modules, f"speed.{name}", SimpleNamespace(rows=made))
    out = tmp_path / "speed.json"
    bench_speed.run(["a", "b"], 2, out)
    bench_speed.run(["b"], 3, out)
    told = table.read(out)
    assert list(told) == ["a", "b"]
    assert "mujoco" in told["a"]["notes"][0]
    load = told["b"]["load"]
    assert 0.0 < load["shortest_pace_ms"] <= load["median_pace_ms"] <= load["longest_pace_ms"]
    assert f"took {load['shortest_pace_ms']:g} to" in table.table(told)
    assert [row["repeats"] for row in told["b"]["rows"]] == [3]
    assert "| a thing | 1 us | 2 us | 0.5 | 0.5 - 0.5 | 3 |  |  |" in table.table(told)


@pytest.mark.parametrize("name", GROUPS)
def test_each_group_is_a_module_with_rows(name):
    pytest.importorskip("mujoco" if name == "simulation" else "rclpy")
    assert callable(import_module(f"speed.{name}").rows)
