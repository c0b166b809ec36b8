# SPDX-License-Identifier: Apache-2.0
"""The comparison of controllers: specimens, tasks, the classical baseline, the table."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import bench_control
from control_campaign import learn
from control_campaign.cases import CASES, PEERS, SEED, SPECIMENS, plan
from control_campaign.hardware import drawn

from pam_orthosis.control import effects
from pam_orthosis.errors import OrthosisError
from pam_orthosis.improvement.learned import learnable
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load


def test_specimens_are_hardware_within_its_bounds_and_no_two_are_alike():
    assert drawn(0) == {}
    ones = [drawn(number) for number in range(1, SPECIMENS + 1)]
    assert all(key.startswith("plant.") for one in ones for key in one)
    for one in ones:
        load(one)
    bands = [one["plant.effects.valve_dead_band.half_width"] for one in ones]
    assert len(set(bands)) == SPECIMENS
    assert all(0.05 <= band <= 0.3 for band in bands)


def test_tasks_are_known_scenarios_and_the_ones_for_all_come_first():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    for case in CASES:
        load(case.overrides())
    first = [specimen for specimen, case in plan() if case.everywhere]
    assert set(first) == set(range(SPECIMENS + 1))
    assert [case.everywhere for _, case in plan()] == sorted((c.everywhere for _, c in plan()), reverse=True)


def _line(specimen, controller, largest):
    figures = {"rms_deg": 0.1, "variation_v_per_s": 50.0, "least_pressure": 1.2e5, "most_pressure": 5e5}
    told = {"specimen": specimen, "case": CASES[0].name, "controller": controller}
    return {**told, "max_deg": largest, **figures}


def test_laws_by_name_are_asked_what_the_shipped_one_is_and_what_a_person_feels_counts():
    case = next(case for case in CASES if case.name == "push")._replace(duration=4.0)
    names = {
        name for _, one, name in bench_control.missing([], bench_control.CONTROLLERS) if one.name == "push"
    }
    assert names == {"paper", *PEERS}
    stiffness = {}
    for name in ("paper", "proxy_sliding_mode"):
        parameters = load(case.overrides())
        run = bench_control._run(parameters, case, name, {})
        stiffness[name] = bench_control._figures(run, parameters, case)["stiffness"]
    assert 20.0 < stiffness["proxy_sliding_mode"] < stiffness["paper"] < 1e4


def test_a_plan_after_a_run_is_asked_for_where_there_is_no_plan_or_one_that_is_not_enough():
    person = next(case.name for case in CASES if case.wearer == "person")
    figures = [{"max_deg": 0.9}, {"max_deg": 1.1}, {"failed": "no motion found"}]
    results = [
        {"specimen": specimen, "case": person, "controller": "planned"} | figure
        for specimen, figure in enumerate(figures)
    ]
    asked = bench_control.missing(results, ["replanned"])
    assert [(specimen, case.name) for specimen, case, _ in asked] == [(1, person), (2, person)]
    done = [{"specimen": 1, "case": person, "controller": "replanned", "max_deg": 0.8}]
    assert [one[0] for one in bench_control.missing(results + done, ["replanned"])] == [2]


def test_where_no_plan_is_found_the_run_without_one_shows_what_the_model_lacks(monkeypatch):
    case = next(case for case in CASES if case.wearer == "person")._replace(duration=6.0)
    seen = []

    def make_plan(parameters, recorded=None):
        if recorded is None:
            raise OrthosisError("no motion found")
        seen.append(recorded)
        return SimpleNamespace(overrides={})

    monkeypatch.setattr(bench_control, "make_plan", make_plan)
    run = bench_control._run(load(case.overrides()), case, "replanned", {})
    assert not seen[0].planned
    at = np.arange(10) / 10
    assert seen[0].followed(at) == pytest.approx(seen[0].position(at), abs=np.radians(1.0))
    assert np.degrees(np.abs(run["reference_angle"] - run["angle"]).max()) < 1.0


def test_a_plan_is_made_after_a_longer_run_with_other_noise_than_the_one_that_is_judged(monkeypatch):
    runs = []

    def loop(_parameters, seed):
        return SimpleNamespace(run=lambda steps: runs.append((seed, steps)) or {"time": None})

    monkeypatch.setattr(bench_control, "ClosedLoop", loop)
    monkeypatch.setattr(bench_control, "make_plan", lambda *_, **__: SimpleNamespace(overrides={}))
    monkeypatch.setattr(bench_control, "recorded", lambda *_: None)
    case = CASES[1]
    bench_control._run(load(case.overrides()), case, "replanned", {})
    (recorded_seed, recorded_steps), (judged_seed, judged_steps) = runs
    assert recorded_seed != judged_seed == SEED
    assert (recorded_steps, judged_steps) == (4000, 1800)


def test_the_table_tells_the_worst_specimen(tmp_path):
    lines = [_line(0, "paper", 0.5), _line(1, "paper", 3.5), _line(2, "paper", 1.0)]
    lines += [_line(0, "learned", 0.2), _line(1, "learned", 0.7), _line(2, "learned", 0.6)]
    lines.append({"specimen": 3, "case": CASES[0].name, "controller": "paper", "failed": "no"})
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(one) + "\n" for one in lines))
    rows = bench_control.table(file).splitlines()[2:]
    paper, learned = ([cell.strip() for cell in row.split("|")[1:-1]] for row in rows)
    assert paper[1:7] == ["2, 1 failed", "paper", "3.50 deg", "1", "0.50", "-"]
    assert paper[-1] == "1"
    assert learned[1:7] == ["2", "learned", "0.70 deg", "1", "0.20", "0.60"]  # of specimen 2, not the worst


def test_what_is_done_is_not_done_again(tmp_path, monkeypatch):
    learnt, asked = [], []

    class Here:
        def __init__(self, *_args, **_settings):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def map(self, work, tasks):
            return map(work, tasks)

    def run(_parameters, case, controller, nominal):
        asked.append((case.name, controller, nominal))
        return {}

    figures = {
        key: value
        for key, value in _line(0, "", 0.3).items()
        if key not in ("specimen", "case", "controller")
    }
    monkeypatch.setattr(bench_control, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(bench_control, "_run", run)
    monkeypatch.setattr(bench_control, "_figures", lambda *_: figures)
    monkeypatch.setattr(bench_control.learn, "learn", lambda _: learnt.append(1) or {"a": 1})
    file, first, second = tmp_path / "results.jsonl", CASES[0].name, CASES[1].name
    bench_control.run(file, ("paper",), 1, 1)
    assert not learnt
    bench_control.run(file, ("paper", "learned"), 2, 1)
    bench_control.run(file, ("learned",), 1, 1)
    assert asked == [
        (first, "paper", {}), (first, "learned", {"a": 1}),
        (second, "paper", {"a": 1}), (second, "learned", {"a": 1}),
    ]  # fmt: skip
    assert learnt == [1]  # once a specimen
    assert len(file.read_text().splitlines()) == 5


def test_what_a_task_changes_is_not_taken_as_it_was(monkeypatch):
    assumed = []
    monkeypatch.setattr(bench_control, "with_nominal", lambda parameters, nominal: assumed.append(nominal))
    monkeypatch.setattr(bench_control, "ClosedLoop", lambda *_: SimpleNamespace(run=lambda _: None))
    nominal = {"valve.supply_pressure": 5.6e5, "valve.conductance": 2.5e-8}
    for name in ("gait 2 s, 75 kg", "gait 2 s, 75 kg, supply of 7 bar"):
        case = next(one for one in CASES if one.name == name)
        bench_control._run(load(case.overrides()), case, "learned", nominal)
    assert assumed == [nominal, {"valve.conductance": 2.5e-8}]


def test_what_is_learned_names_no_effect_that_controllers_leave_alone():
    values = {f"{n}.{q.name}": q.typical for n in learn.EFFECTS for q in KNEE.catalogue[n].parameters}
    assert all(learn._matters(name, values) for name in learn.EFFECTS)
    assert set(learn.EFFECTS) <= set(learnable(KNEE))
    stages = {n: KNEE.catalogue[n].stage for n in learn.EFFECTS}
    assert set(learn.MECHANICAL) == {n for n, stage in stages.items() if stage in effects.MECHANICAL}
    assert learn.tolerances(0) == {}
    load(learn.tolerances(1))
