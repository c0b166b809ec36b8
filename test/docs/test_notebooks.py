# SPDX-License-Identifier: Apache-2.0
"""The notebooks run from an empty folder with the wheel, and what they print is what their pages show."""

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


def test_there_are_five_and_each_has_a_page():
    assert len(FILES) >= 5
    assert set(pages()) == {f"notebooks/{file.stem}.md" for file in FILES}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_it_runs_and_prints_what_its_page_shows(file, program):
    kept, made = notebooks.texts(nbformat.read(file, as_version=4)), notebooks.texts(notebooks.executed(file))
    assert kept
    assert notebooks.same(made, kept), made
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


@pytest.mark.parametrize(
    ("made", "same"),
    [("1.51 N m", True), ("1.4 N m", False), ("1.5 N", False), ("1.5 N m and 2", False)],
)
def test_what_is_printed_may_differ_in_numbers_that_are_near(made, same):
    assert notebooks.same([made], ["1.5 N m"]) is same


def test_a_check_keeps_nothing_and_fails_where_outputs_differ(tmp_path, monkeypatch, capsys):
    for name, shown in {"good": "3\n", "bad": "4\n"}.items():
        cell = nbformat.v4.new_code_cell("print(3)")
        cell.outputs = [nbformat.v4.new_output("stream", name="stdout", text=shown)]
        nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / f"{name}.ipynb")
    before = {file: file.read_text() for file in tmp_path.iterdir()}
    monkeypatch.setattr(notebooks, "FOLDER", tmp_path)
    for names, status in ((["good"], 0), ([], 1)):
        monkeypatch.setattr(sys, "argv", ["notebooks.py", "--check", *names])
        assert notebooks.main() == status
    assert capsys.readouterr().out.splitlines()[1] == "bad.ipynb: prints something else than it shows"
    assert {file: file.read_text() for file in tmp_path.iterdir()} == before
