# SPDX-License-Identifier: Apache-2.0
"""The animated picture of a run, and pictures that show what they should."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pam_orthosis.bag.read import read_bag
from pam_orthosis.cli.main import main
from pam_orthosis.report import walk

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def animation(tmp_path_factory):
    folder = tmp_path_factory.mktemp("animation")
    bag = ROOT / "bags" / "walk"
    assert main(["report", str(bag), "--only", "animation", "--out", str(folder)]) == 0
    return folder / "walk.gif"


def test_it_shows_one_gait_cycle_for_ever_and_moves(animation):
    with Image.open(animation) as image:
        assert image.n_frames == 40
        assert image.info["loop"] == 0
        assert image.n_frames * image.info["duration"] == 2000
        frames = []
        for number in (0, 10, 20):
            image.seek(number)
            frames.append(np.asarray(image.convert("L"), dtype=float))
    for one, other in ((0, 1), (1, 2)):
        assert (np.abs(frames[one] - frames[other]) > 60).sum() > 2000
    assert animation.stat().st_size < 2_000_000


def test_that_of_the_front_page_is_of_the_reference_bag(animation):
    with Image.open(animation) as made, Image.open(ROOT / "docs" / "pictures" / "walk.gif") as shown:
        assert shown.n_frames == made.n_frames
        for number in (0, 12, 30):
            made.seek(number)
            shown.seek(number)
            pixels = [np.asarray(one.convert("L"), dtype=float) for one in (made, shown)]
            assert (np.abs(pixels[0] - pixels[1]) > 60).mean() < 0.01


def test_a_bag_without_pressures_is_refused(tmp_path, capsys):
    assert main(["report", str(tmp_path), "--only", "animation"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_legends_of_the_picture_cover_no_curve(monkeypatch):
    figures = []
    monkeypatch.setattr(walk.Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    bag = ROOT / "bags" / "walk"
    assert read_bag(bag, ("angle",))
    walk.draw_run(bag, 3.0, "", None)
    (figure,) = figures
    figure.canvas.draw()
    legends = [axes for axes in figure.axes if axes.get_legend()]
    assert len(legends) == 2
    for axes in legends:
        box = axes.get_legend().get_window_extent()
        assert box.y0 >= axes.get_window_extent().y1 - 1
