# SPDX-License-Identifier: Apache-2.0
"""The documentation: its site builds without a warning, its commands and examples run, no row is empty."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import pam_orthosis
from pam_orthosis.cli.main import VERBS, Parser
from pam_orthosis.model import parameters
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.plant import Plant

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

import commands as shown  # noqa: E402
from generators import equations, nodes  # noqa: E402

COMMANDS = shown.commands()
CHEAP = [command for command in COMMANDS if command.kind == "cheap"]


def examples():
    """Return the Python examples of the page on extending."""
    return re.findall(r"```python\n(.*?)```", (DOCS / "extending.md").read_text(), flags=re.S)


def _thing(place):
    """Return the function or class of a dotted place below the package."""
    thing, name = pam_orthosis, "pam_orthosis"
    for part in place.split("."):
        name = f"{name}.{part}"
        if not hasattr(thing, part):
            import_module(name)
        thing = getattr(thing, part)
    return thing


def test_every_equation_is_cited_where_it_is_used():
    found = equations.citations()
    assert list(found) == list(range(1, 38))
    assert [number for number, places in found.items() if not places] == []
    things = {place.place for places in found.values() for place in places}
    assert all(callable(_thing(place)) for place in things)
    page = (DOCS / "equations.md").read_text()
    assert re.findall(r"^\| \((\d+)\) \| [^|]+ \| `", page, flags=re.M) == [str(n) for n in range(1, 38)]


def test_a_citation_is_found_in_ranges_and_lists():
    assert equations.cited("By Eqs. (14) and (16)-(18), and Eq. (25).") == {14, 16, 17, 18, 25}
    assert equations.cited("Equation 14, or (15).") == set()
    assert equations.sentence("Return F. It is linear, Eq. (14), in p. Eq. (27) too.", 14) == (
        "It is linear, Eq. (14), in p"
    )


def test_every_node_and_every_effect_has_a_page():
    assert {path.stem for path in (DOCS / "nodes").glob("*.md")} == {"index", *nodes.executables()}
    assert {path.stem for path in (DOCS / "effects").glob("*.md")} == {"index", *CATALOGUE}


def test_the_parameters_of_a_node_are_those_that_it_reads():
    tree = parameters.load()
    with nodes.accessed() as keys:
        assert tree.leg.person.mass > 0
        tree.leg.items()
    assert keys == {"leg.person.mass"}
    page = (DOCS / "nodes" / "position_controller.md").read_text()
    assert "`control.observer.pole`" in page
    assert "`plant." not in page.split("## Parameters")[1]


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="mkdocs is not installed")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr
    assert (tmp_path / "effects" / "backlash.html").exists()
    assert (tmp_path / "css" / "tables.css").exists()  # strict or not, mkdocs does not look
    assert 'href="css/tables.css"' in (tmp_path / "speed.html").read_text()
    assert not list(tmp_path.rglob("*.py"))


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.line)
def test_every_command_is_one_that_the_program_takes(command):
    first, *arguments = command.line.split()
    if first != "pam-orthosis" or arguments == ["--help"]:
        return
    verb, *rest = arguments
    assert verb in VERBS
    parser = Parser(prog=verb)
    import_module(f"pam_orthosis.cli.{verb.replace('-', '_')}").add_arguments(parser)
    if "--help" not in rest:
        parser.parse_args(rest)


@pytest.mark.parametrize("line", sorted({command.line for command in CHEAP}))
def test_cheap_commands_run(line, documented):
    if line.startswith("pam-orthosis run"):
        pytest.importorskip("rclpy")
    if line.endswith("--help"):
        with pytest.raises(SystemExit, match="0"):
            documented(line)
    else:
        assert documented(line)[0] in (0, 1)


def test_a_new_effect_is_one_file(monkeypatch):
    space = {}
    exec(examples()[0], space)
    (effect,) = space["EFFECTS"]
    monkeypatch.setitem(CATALOGUE, effect.name, effect)
    parameters._shipped_rows.cache_clear()
    try:
        on = parameters.load({"plant.effects.detent.enabled": True, "plant.effects.detent.torque": 5.0})
        moved = []
        for p in (parameters.load(), on):
            plant = Plant(p)
            for _ in range(40):
                plant.advance(4.6, 5.4)
            moved.append(plant.truth().angle)
    finally:
        monkeypatch.undo()
        parameters._shipped_rows.cache_clear()
    assert abs(moved[0] - moved[1]) > 1e-3


def test_another_controller_stands_in(capsys):
    exec(examples()[1], {})
    error = float(capsys.readouterr().out.split()[0])
    assert 0.0 < error < 0.1
