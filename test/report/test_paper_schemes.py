# SPDX-License-Identifier: Apache-2.0
"""Figs. 1 to 3, 6 and 7: they show the declared machines and follow their parameters."""

from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.patches import Circle
from PIL import Image

from pam_orthosis.cli import paper
from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.parameters import load
from pam_orthosis.model.shapes import scenario_shape
from pam_orthosis.report.paper import blocks, drawings
from pam_orthosis.report.paper.drawings import SCHEMES, schemes


def of_machine(draw):
    return lambda overrides: draw(load(overrides))


DRAW = {
    "device": drawings.device,
    "rig": of_machine(drawings.rig),
    "rig_control": of_machine(blocks.rig_control),
    "mechanics": of_machine(drawings.mechanics),
    "knee_control": of_machine(blocks.knee_control),
}
CHANGES = [
    ("device", "leg.cogwheel_diameter", 0.14),
    ("device", "leg.thigh.length", 0.46),
    ("device", "leg.ankle.plantarflexor.lever", 0.055),
    ("device", "leg.shoe_length", 0.3),
    ("device", "leg.bearing_height", 0.1),
    ("rig", "rig.position_offset", 0.17),
    ("rig", "rig.carriage_mass", 25.0),
    ("rig", "muscle.dmsp_20.length", 0.45),
    ("rig", "plant.rig.load_cell.accuracy", 20.0),
    ("rig_control", "rig.position.pole", 25.0),
    ("rig_control", "rig.pressure.gain", 40.0),
    ("mechanics", "leg.person.present", True),
    ("mechanics", "leg.shank.mass", 1.4),
    ("mechanics", "leg.bearing_height", 0.1),
    ("knee_control", "control.position.c1", 30.0),
    ("knee_control", "control.observer.pole", 90.0),
    ("knee_control", "control.pressure.gain", 40.0),
    ("knee_control", "leg.cogwheel_diameter", 0.12),
]


def content(figure):
    """Return all words of a figure, and all places where something is drawn."""
    words, places = [], []
    for axes in figure.axes:
        words += [axes.get_title(), *(one.get_text() for one in axes.texts)]
        words += [cell.get_text().get_text() for table in axes.tables for cell in table.get_celld().values()]
        places += [np.asarray(line.get_xydata()).round(9).tolist() for line in axes.lines]
        places += [one.get_path().transformed(one.get_patch_transform()).vertices.round(9).tolist()
                   for one in axes.patches]  # fmt: skip
    return words, places


@pytest.mark.parametrize(("name", "key", "value"), CHANGES)
def test_a_figure_follows_its_parameters(name, key, value):
    before, after = content(DRAW[name]({})), content(DRAW[name]({key: value}))
    assert before != after


def test_all_are_drawn_and_named_in_the_verb():
    drawn = schemes()
    assert drawn.keys() == SCHEMES.keys() == DRAW.keys()
    assert tuple(f"{name}.png" for name in drawn) == paper.SCHEMES
    for png in drawn.values():
        with Image.open(BytesIO(png)) as picture:
            assert picture.width > 800
            assert len(picture.convert("L").getcolors()) > 50


@pytest.mark.parametrize("configuration", [1, -1])
@pytest.mark.parametrize("height", [0.0, 0.12])
def test_the_ankle_is_on_its_bearing_in_any_pose(configuration, height):
    p = load({"leg.configuration": configuration, "leg.bearing_height": height}).leg
    for knee in np.linspace(0.0, 1.5, 7):
        pose = drawings.pose_of(knee, 0.1, p)
        assert pose.ankle[1] == pytest.approx(height, abs=1e-12)
        assert np.linalg.norm(pose.ankle - pose.knee) == pytest.approx(p.shank.length)
        assert pose.toes - pose.shank == pytest.approx(configuration * (np.pi / 2 + 0.1))


def test_the_device_has_muscles_as_long_as_the_model_says():
    """Those in front: two at the knee, two at the ankle, by the law of cosines."""
    (axes,) = drawings.device().axes
    drawn = [np.linalg.norm(np.diff(line.get_xydata(), axis=0)) for line in axes.lines
             if same_color(line.get_color(), drawings.MUSCLE) and line.get_alpha() == 1.0]  # fmt: skip
    joints = drawings._joints({})
    knee, ankle = (float(scenario_shape(joints[name])(drawings.PHASE)[0]) for name in ("knee", "ankle"))
    p = joints["knee"]
    expected = [p.muscle.dmsp_20.length - float(one) for one in leg.contractions(knee, p.leg)]
    for part in (p.leg.ankle.dorsiflexor, p.leg.ankle.plantarflexor):
        ground, lever = part.ground, part.lever
        rope = [np.sqrt(ground**2 + lever**2 - 2 * ground * lever * np.cos(part.angle + q))
                for q in (0.0, ankle)]  # fmt: skip
        expected.append(joints["ankle"].muscle.dmsp_10.length - part.contraction - (rope[0] - rope[1]))
    assert drawn == pytest.approx(expected)


def test_the_sprocket_and_the_shoe_have_their_size():
    (axes,) = drawings.device({"leg.cogwheel_diameter": 0.14, "leg.shoe_length": 0.3}).axes
    assert {one.radius for one in axes.patches if isinstance(one, Circle)} == {0.07}
    lengths = [np.linalg.norm(np.ptp(line.get_xydata(), axis=0)) for line in axes.lines]
    assert sum(length == pytest.approx(0.3) for length in lengths) == 2


def test_the_forces_at_the_rig_are_in_balance():
    """What fig. 2 says of both pressures, by the nominal force of Eq. (14)."""
    p = load()
    words = [one.get_text() for one in drawings.rig(p).axes[0].texts]
    left, right = (word.split(" = ")[1] for word in words if word.startswith("$F_"))
    assert left == right
    positioner = next(word for word in words if word.startswith("MAS-40"))
    contraction, gauge = (float(positioner.split(mark)[0].split()[-1]) for mark in (" mm", " bar"))
    force = drawings.muscle.towing_force(1e-3 * contraction, 1e5 * gauge, p.muscle.mas_40)
    assert float(force) == pytest.approx(float(left.split()[0]), rel=0.02)


def test_the_bodies_weigh_what_is_listed():
    p = load({"leg.person.present": True})
    words, _ = content(drawings.mechanics(p))
    for mass in (p.leg.knee_mass, p.leg.shoe_mass, p.leg.person.thigh.mass_fraction * p.leg.person.mass):
        assert f"{mass:.3g}" in words
    assert {f"$m_{{{name}}}$" for name in drawings.BODIES} <= set(words)
