# SPDX-License-Identifier: Apache-2.0
"""The curves of the speed table are found in it again, and drawn."""

import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from speed import scaling
from speed.curves import CURVES, GAP_CATALOGUE, GAP_LENGTH, draw, points, told
from speed.rows import row

from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.model.parameters import load


def rows_of(curve, sizes):
    return [asdict(row("scaling", told(curve, size), "s", [2.0 * size])) for size in sizes]


def test_points_are_read_back_in_order_and_only_those_of_the_curve():
    rows = rows_of(GAP_LENGTH, (60, 15, 600)) + rows_of(GAP_CATALOGUE, (30,))
    assert points(GAP_LENGTH, rows) == [(15, 30), (60, 120), (600, 1200)]
    assert points(GAP_CATALOGUE, rows) == [(30, 60)]


def test_a_picture_is_drawn_of_all_curves(tmp_path):
    results = {"scaling": {"rows": [one for curve in CURVES for one in rows_of(curve, (1, 2, 4))]}}
    draw(results, tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")


def test_what_grows_in_proportion_has_ratio_1_and_what_is_steeper_misses_the_goal():
    even = scaling._growth("x", "s", {size: [0.1 * size] for size in (15, 30, 60, 600)})
    steep = scaling._growth("x", "s", {size: [0.1 * size**1.3] for size in (15, 30, 60, 600)})
    assert abs(even.ratio - 1) < 1e-9
    assert even.met
    assert steep.ratio > 2
    assert not steep.met


def test_the_recording_moves_the_knee_and_is_uniform():
    parameters = load(scaling.AS_BELIEVED)
    arrays = scaling.moved(parameters, 4.0)
    recording = from_arrays("moved", knee(parameters), arrays)
    assert abs(recording.duration - 4.0) < 1e-9
    assert np.ptp(arrays["angle"]) > 0.3
    steps = arrays["angle"] / parameters.plant.sensor.angle_resolution
    assert np.abs(steps - np.round(steps)).max() < 1e-6


def test_the_command_draws_the_committed_results(tmp_path):
    benchmarks = Path(__file__).resolve().parents[2] / "benchmarks"
    command = [benchmarks / "bench_speed.py", "curves", benchmarks / "results" / "speed.json"]
    done = subprocess.run([sys.executable, *command, "--out", tmp_path / "curves.png"], check=False)
    assert done.returncode == 0
    assert (tmp_path / "curves.png").stat().st_size > 10_000
