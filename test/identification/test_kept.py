# SPDX-License-Identifier: Apache-2.0
"""What a table does not identify is said, and what stays; a muscle's own file scales the volume."""

import json
import re

import numpy as np
import pytest
import yaml
from muscle_rig import LENGTH, LEVELS, static_force, write

from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.identification.identify import USUAL_MISFIT
from pam_orthosis.model.effects import KINDS
from pam_orthosis.model.parameters import load


@pytest.fixture
def force(tmp_path):
    """Return a table of a static map."""
    p, x = (one.ravel() for one in np.meshgrid(LEVELS, np.linspace(0.001, 0.075, 9)))
    f = static_force(x, p)
    rows = np.column_stack([p, LENGTH - x, f])[f > 0]
    return str(write(tmp_path / "map.csv", rows, "p_Pa_gauge,L_m,F_N"))


@pytest.fixture
def volume(tmp_path):
    """Return a table of a volume, 94 cm3 at rest."""
    p, x = (one.ravel() for one in np.meshgrid([1e5, 3e5, 5e5], [0.0, 0.02, 0.04, 0.06]))
    rows = np.column_stack([p, x, 94.0 * (1 + 14 * x - 60 * x**2) * (1 + 4e-8 * p)])
    return str(write(tmp_path / "volume.csv", rows, "p_Pa_gauge,dL_m,V_cm3"))


def test_volume_and_damping_of_the_shipped_muscle_stay_and_that_is_said(force, volume, capsys):
    shipped = load().muscle.dmsp_20
    kept = f"volume (that of dmsp_20 stays, {shipped.volume.v[0] * 1e6:.0f} cm3 at rest)"
    damping = f"damping ({shipped.force.damping:.0f} N s/m stays)"
    common = ["--muscle", "dmsp_20", "--nominal-length-m", "0.3"]
    assert main(["identify", force, *common]) == 0
    assert f"  not identified: {kept} and {damping}\n" in capsys.readouterr().out
    assert main(["identify", force, *common, "--damping", "240", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["not_identified"] == f"not identified: {kept}"
    assert main(["identify", force, volume, *common, "--damping", "240"]) == 0
    printed = capsys.readouterr().out
    assert "not identified" not in printed
    known = re.findall(r"^  (v_\d|w_\d) = +\S+ \+- \S+$", printed, flags=re.MULTILINE)
    assert known == ["v_0", "v_1", "v_2", "w_1", "w_2"]


def test_a_muscle_of_its_own_size_takes_its_share_of_the_volume(force, volume, tmp_path, capsys):
    own, out = tmp_path / "own.yaml", tmp_path / "rows.yaml"
    own.write_text("length: 0.3\ndiameter: 0.02\n")
    shipped = load().muscle.dmsp_20
    share = (0.02 / shipped.geometry.diameter) ** 2 * 0.3 / shipped.map_length
    rest = share * shipped.volume.v[0]
    common = ["--muscle", str(own), "--out", str(out)]
    assert main(["identify", force, *common]) == 0
    said = f"volume (that of dmsp_20 in proportion to length and cross-section, {rest * 1e6:.0f} cm3 at rest)"
    assert said in capsys.readouterr().out
    assert load(patch.read(out)).muscle.dmsp_20.volume.v[0] == pytest.approx(rest)
    assert "in proportion" in out.read_text()
    out.unlink()
    assert main(["identify", force, volume, *common]) == 0
    assert load(patch.read(out)).muscle.dmsp_20.volume.v[0] == pytest.approx(94e-6, rel=0.01)
    text = out.read_text()
    assert "in proportion to length" not in text
    sources = yaml.safe_load(text)["dmsp_20"]
    assert sources["geometry"]["diameter"]["source"].startswith("the muscle's own file")
    assert sources["force"]["a"]["source"].startswith("identified on a measured table")


def test_it_says_how_well_the_force_of_a_muscle_of_its_own_is_known(force, tmp_path, capsys):
    """The gap workflow allows for as large an error of the map as a catalogue's muscle has."""
    own = tmp_path / "own.yaml"
    own.write_text("length: 0.3\ndiameter: 0.02\n")
    assert main(["identify", force, "--muscle", str(own)]) == 0
    size = float(re.search(r"sizes: {force_map_misfit: ([\d.]+)}", capsys.readouterr().out)[1])
    assert 0.5 < size < 5.0, "the polynomial misses this map by some newtons"
    (kind,) = (one for one in KINDS if one.name == "force_map_misfit")
    assert kind.parameters[0].prior == USUAL_MISFIT
    assert main(["identify", force, "--muscle", "dmsp_20", "--nominal-length-m", "0.3"]) == 0
    assert "force_map_misfit" not in capsys.readouterr().out
