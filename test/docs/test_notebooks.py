# SPDX-License-Identifier: Apache-2.0
"""The notebooks run from an empty folder with the wheel, and what they print is what their pages show."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
pytest.importorskip("nbclient", reason="nbclient is not installed")

import notebooks  # noqa: E402
from generators.notebooks import pages  # noqa: E402

FILES = sorted(notebooks.FOLDER.glob("*.ipynb"))
NUMBER = re.compile(r"-?\d+\.?\d*")


def test_there_are_five_and_each_has_a_page():
    assert len(FILES) >= 5
    assert set(pages()) == {f"notebooks/{file.stem}.md" for file in FILES}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_it_runs_and_prints_what_its_page_shows(file, program):
    kept, made = notebooks.texts(nbformat.read(file, as_version=4)), notebooks.texts(notebooks.executed(file))
    assert kept
    assert [NUMBER.sub("N", text) for text in made] == [NUMBER.sub("N", text) for text in kept]
    numbers = [[float(one) for text in texts for one in NUMBER.findall(text)] for texts in (made, kept)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=0.02)
    for text in kept:
        assert text.rstrip() in pages()[f"notebooks/{file.stem}.md"]


def test_a_notebook_imports_the_wheel(tmp_path, program):
    cell = nbformat.v4.new_code_cell("import pam_orthosis; print(pam_orthosis.__file__)")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / "where.ipynb")
    (place,) = notebooks.texts(notebooks.executed(tmp_path / "where.ipynb"))
    assert place.startswith(str(program.parents[1]))


def test_a_cell_that_fails_is_noticed(tmp_path):
    bad = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")])
    nbformat.write(bad, tmp_path / "bad.ipynb")
    with pytest.raises(Exception, match="ZeroDivisionError"):
        notebooks.executed(tmp_path / "bad.ipynb")
