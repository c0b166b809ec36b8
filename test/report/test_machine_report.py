# SPDX-License-Identifier: Apache-2.0
"""Reports of bags of machines that are not shipped: names and units are theirs."""

import csv

import numpy as np
import pytest
from PIL import Image

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.simulated import record_run
from pam_orthosis.cli.main import main
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.report.run_data import read_run, view

CENTRE = {"slide": 0.15, "elbow": 0.1}
SHOWN = {
    "slide": ("position", "mm", 1e3, "force", "N"),
    "elbow": ("angle", "deg", 180 / np.pi, "torque", "N m"),
}


@pytest.fixture(scope="module", params=list(CENTRE))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def bag(name, machine_files, tmp_path_factory):
    """Return a bag of two seconds of a sine."""
    motion = {
        "scenario.trajectory": "sine",
        "scenario.sine.centre": CENTRE[name],
        "scenario.sine.amplitude": 0.05,
        "scenario.start_hold": 0.1,
        "scenario.start_ramp": 0.5,
        "scenario.duration": 2.0,
    }
    folder = tmp_path_factory.mktemp("bags") / name
    record_run(load(motion, read_machine(machine_files[name])), "default", folder)
    return folder


def test_panels_have_the_names_and_units_of_the_machine(bag, name):
    coordinate, unit, factor, _, _ = SHOWN[name]
    run = read_run(bag)
    measured = read_bag(bag, [coordinate])[coordinate].value
    assert [panel.label for panel in run.panels][:4] == [
        f"{name} {coordinate} / {unit}", f"error / {unit}", "pressure / bar absolute", "valve voltage / V"
    ]  # fmt: skip
    drawn = {curve.name: curve.value for panel in run.panels for curve in panel.curves}
    assert drawn["measured"] == pytest.approx(factor * measured)
    assert {f"{one}_pressure".replace("_", " ") for one in run.machine.names} < drawn.keys()


def test_the_picture_shows_the_load_where_it_was(bag, name):
    run = read_run(bag)
    last = view(run, np.array([0, len(run.time) - 1]))
    if name == "slide":
        moved = last.sketch.body[1].mean(axis=0) - last.sketch.body[0].mean(axis=0)
        assert moved == pytest.approx([run.measured.value[-1] - run.measured.value[0], 0.0])
    else:
        (x0, z0), (x1, z1) = last.sketch.body[:, 1]
        turned = np.arctan2(z0, x0) - np.arctan2(z1, x1)
        assert turned == pytest.approx(run.measured.value[-1] - run.measured.value[0])
    assert set(last.pressures) == set(run.machine.names)


def test_every_kind_of_report_is_made(bag, name, tmp_path):
    coordinate, unit, *_ = SHOWN[name]
    for kind in ("page", "picture", "table"):
        assert main(["report", str(bag), "--only", kind, "--out", str(tmp_path)]) == 0
    assert main(["report", str(bag), "--animation", str(tmp_path / f"{name}.gif")]) == 0
    page = (tmp_path / f"{name}.html").read_text(encoding="utf-8")
    assert f"maximum error / {unit}" in page
    assert "<td>machine.mechanism.inertia</td>" not in page, "its file's value is no change"
    assert "<td>scenario.duration</td>" in page
    with Image.open(tmp_path / f"{name}.gif") as gif:
        assert gif.n_frames > 10
    with open(tmp_path / f"{name}.csv", encoding="utf-8") as stream:
        assert {"time", coordinate, f"reference_{coordinate}"} < set(next(csv.reader(stream)))


def test_a_bound_in_the_other_unit_is_refused_in_one_line(bag, name, capsys):
    other = {"mm": "deg", "deg": "mm"}[SHOWN[name][1]]
    assert main(["report", str(bag), "--only", "page", f"--bound-{other}", "3"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
