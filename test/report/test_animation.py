# SPDX-License-Identifier: Apache-2.0
"""The animated picture of a run, and pictures that show what they should."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.cli.main import main
from pam_orthosis.report import animation as animation_module
from pam_orthosis.report import walk

ROOT = Path(__file__).resolve().parents[2]
WALK = ROOT / "bags" / "walk"


@pytest.fixture(scope="module")
def animation(tmp_path_factory):
    folder = tmp_path_factory.mktemp("animation")
    assert main(["report", str(WALK), "--animation", str(folder / "walk.gif")]) == 0
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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([str(ROOT), "--animation", "new.gif"], "no bag"),
        ([str(WALK), "--animation", "new.mp4"], "ends in .gif"),
        ([str(WALK), "--animation", "new.gif", "--only", "page"], "not allowed with"),
        ([str(WALK), "--animation", "there.gif"], "there.gif exists; choose another --out"),
        ([str(WALK), "--animation", "there.gif", "--overwrite"], "an --animation is a new file"),
    ],
)
def test_what_cannot_be_made_is_refused_in_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("there.gif").write_text("mine")
    assert main(["report", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [one.name for one in tmp_path.iterdir()] == ["there.gif"]
    assert Path("there.gif").read_text() == "mine"


def test_the_error_that_it_draws_is_reference_less_measured(monkeypatch):
    drawn = []
    plot = animation_module._draw_curves
    monkeypatch.setattr(
        animation_module, "_draw_curves", lambda *given: drawn.append(plot(*given)) or drawn[0]
    )
    monkeypatch.setattr(animation_module, "FRAMES_PER_SECOND", 1)
    animation_module.write_animation(WALK, "", BytesIO())
    time, error = drawn[0][1].axes.lines[0].get_data()
    bag = read_bag(WALK, ("angle", "reference_angle"))
    _, (reference, angle) = aligned(bag["reference_angle"], bag["angle"])
    expected = np.degrees(reference - angle)[-len(time) :]
    assert len(time) > 300
    assert error == pytest.approx(expected, abs=1e-12)


def test_legends_of_the_picture_cover_no_curve(monkeypatch):
    figures = []
    monkeypatch.setattr(walk.Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    walk.draw_run(WALK, 3.0, "", None)
    (figure,) = figures
    figure.canvas.draw()
    legends = [axes for axes in figure.axes if axes.get_legend()]
    assert len(legends) == 2
    for axes in legends:
        assert not axes.get_legend().get_window_extent().overlaps(axes.get_window_extent())
