# SPDX-License-Identifier: Apache-2.0
"""The summary tables of the results say what the committed results say."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import generators  # noqa: E402
from generators import conclusions, results  # noqa: E402


def _rows(text):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line][2:]


@pytest.mark.parametrize("name", generators.blocks())
def test_every_table_has_rows_of_one_width_and_no_empty_first_cell(name):
    lines = [line for line in generators.blocks()[name]().splitlines() if line.startswith("|")]
    assert len(lines) > 2
    assert len({line.replace("\\|", "").count("|") for line in lines}) == 1
    assert all(cells[0] for cells in _rows("\n".join(lines)))


def test_the_table_of_the_gap_workflow_counts_all_blind_cases():
    cases = results.blind_cases()
    counted = sum(int(row[1]) for row in _rows(results.gap(cases)))
    alone = [case for case in cases if case["set"] == "alone"]
    failed = [c for c in cases if c["set"].endswith("-none") and "found" not in c]
    assert counted == len(cases) - len(alone) - len(failed) > 300
    medium = [c for c in cases if (c["set"], c["size"]) == ("realistic", "medium")]
    right = sum(
        "found" in c and {e["name"] for e in c["found"]["effects"]} == set(c["effects"]) for c in medium
    )
    (row,) = (
        row for row in _rows(results.gap(results.blind_cases())) if row[0] == "one effect, medium, realistic"
    )
    shown = int(row[2].split()[1])
    assert right <= shown <= right + 3  # a set of two counts too


def test_every_set_of_blind_cases_has_its_row_and_the_rows_add_up_to_all():
    files = {file.stem.removeprefix("gap_blind_") for file in results.RESULTS.glob("gap_blind_*.jsonl")}
    rows = _rows(results.gap_sets())
    assert [row[0] for row in rows] == list(results.BLIND)
    assert set(results.BLIND) == files
    single = [c for c in results.blind_cases() if c["set"] in ("clean", "realistic")]
    named = [tuple(map(int, row[1].split(" of "))) for row in rows if row[1] != "-"]
    assert tuple(map(sum, zip(*named, strict=True))) == results.right(single)
    outside = [c["found"]["verdict"] for c in results.blind_cases() if c["set"] == "outside" and "found" in c]
    shown = [map(int, row[5].split(" of ")[0].split(", ")) for row in rows if row[5] != "-"]
    assert list(map(sum, zip(*shown, strict=True))) == [outside.count(one) for one in results.gap_table.OPEN]


def test_conclusions_say_what_the_results_say(monkeypatch):
    runs = [
        {"case": case, "controller": name, "max_deg": error, "specimen": 1}
        for name, error in (("planned", 5.0), ("paper", 1.0), ("learned", 2.0))
        for case in results.TASKS
    ]
    monkeypatch.setattr(results, "drawn_runs", lambda: runs)
    words = conclusions.controllers()
    assert "`nominal` has the smallest maximum error: its median is 1.00 degrees" in words
    assert "`planned` 3 of 3" in words
    found, tried = results.right(results.chosen_of(results.blind_cases(), "realistic", "medium"))
    assert f"{found} of {tried}" in conclusions.gap()
    assert "asked are 90%" in conclusions.gap()


def test_what_is_asked_of_the_gap_workflow_stands_beside_what_the_last_set_reached():
    last = [case for seed in results.LATEST for case in results.blind_set(seed)]
    late = [case["seed"] for seed in results.LATEST_PAIRS for case in results.blind_set(seed)]
    last = [case for case in last if case["set"] != "pairs" or case["seed"] in late]
    rows = {row[0]: row[1:] for row in _rows(results.gap_asked())}
    classes = ("one effect", "two effects", "nothing hidden", "an effect outside the catalogue")
    counted = [row[1] for what, row in rows.items() if what.startswith(classes)]
    assert sum(int(cell.split(" of ")[1].split()[0]) for cell in counted) == len(last)
    medium = results.chosen_of(last, "realistic", "medium")
    asked, reached, met, small = rows["one effect, medium, realistic"]
    part, whole = results.right(medium)
    assert (asked, reached.split(" (")[0]) == ("90%", f"{part} of {whole}")
    assert met == ("yes" if part >= 0.9 * whole else "no")
    named, pairs = results.both(results.chosen_of(last, "pairs"))
    assert rows["two effects, both named"][2] == ("yes" if named >= 0.9 * pairs else "no")
    assert int(small) == sum(map(results.gap_table.too_small, medium))
    assert rows["nothing hidden, realistic, verdict `none`"][2] == "yes"
    singles = [r for r in last if r["set"] in ("clean", "realistic")]
    explained = [r["found"]["closure"]["overall"] for r in singles if r["found"]["verdict"] == "explained"]
    closed = sum(share >= 0.95 for share in explained)
    _, reached, met, _ = rows["95 % of the gap closed, where it is called explained"]
    assert reached.split(" (")[0] == f"{closed} of {len(explained)}"
    assert met == ("yes" if closed >= 0.95 * len(explained) else "no")
    told = [r for r in results.chosen_of(last, "outside") if not results.gap_table.DEPENDS[r["effects"][0]]]
    right = sum(r["found"]["verdict"] == "unexplained" for r in told)
    assert rows["an effect outside, said to depend on no signal of the instant"][1].startswith(
        f"{right} of {len(told)} "
    )


def test_the_table_of_controllers_shows_the_worst_runs():
    lines = (results.RESULTS / "control.jsonl").read_text(encoding="utf-8").splitlines()
    runs = [json.loads(line) for line in lines]
    paper = [r["max_deg"] for r in runs if r.get("specimen") and r.get("controller") == "paper"]
    (row,) = (row for row in _rows(results.control()) if row[0] == "all tasks")
    cell = row[1 + results.CONTROLLERS.index("paper")]
    assert f"/ {max(paper):.2f} deg" in cell
    assert f"{sum(error > 3.0 for error in paper)} of {len(paper)} above" in cell


def test_the_safety_monitor_misses_no_trip_and_trips_falsely_once_in_ten_minutes_at_most():
    found = results.safety.summary(results.safety.read(results.RESULTS / "safety.jsonl"))
    assert (found["walks"], found["nonsense"]) == (461, 200)  # 200 of random persons, the others with spasms
    assert found["missed"] == found["nonsense_beyond_margin"] == 0
    assert 10 * found["false"] / found["minutes"] <= 1


def test_learning_halves_the_error_on_every_hardware_sample():
    learned = _rows(results.blocks()["repetition"]())
    assert [row[0] for row in learned] == ["default", "person"]
    assert all(int(row[1]) == 11 and float(row[4]) <= 0.5 for row in learned)


def test_intervals_of_identify_hold_for_another_repeat():
    rows = _rows(results.blocks()["identify-repeats"]())
    assert [row[0] for row in rows] == ["3", "4", "6"]
    assert all(float(row[1].strip("%")) >= 90 for row in rows)  # of all coefficients; the worst stands beside
