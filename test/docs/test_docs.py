# SPDX-License-Identifier: Apache-2.0
"""The documentation: its generated pages, its commands and examples, its words."""

import re
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import pam_orthosis
from pam_orthosis.cli.help_texts import ANSWERS, EXAMPLES
from pam_orthosis.cli.main import VERBS, verb_parser
from pam_orthosis.discrepancy.preparation import check
from pam_orthosis.discrepancy.preparation.beginning import HELD_SHARE
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.user_file import load_system
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import machines, parameters
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.mechanisms import MECHANISMS
from pam_orthosis.model.mechanisms.one_axis import TRANSMISSIONS
from pam_orthosis.model.plant import Plant

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

import commands as shown  # noqa: E402
import generate  # noqa: E402
import generators  # noqa: E402
import pictures  # noqa: E402
from generators import declared, equations, nodes  # noqa: E402

BY_HAND = sorted(DOCS.rglob("*.md"))
COMMANDS = [command for command in shown.all_commands() if command.line.startswith("pam-orthosis")]
MOST_WORDS = 16_000


@pytest.fixture(scope="module")
def pages():
    return generators.pages()


def examples():
    """Return the Python examples of the page on extending."""
    return re.findall(r"```python\n(.*?)```", (DOCS / "howto" / "extend.md").read_text(), flags=re.S)


def _thing(place):
    """Return the function or class of a dotted place below the package."""
    thing, name = pam_orthosis, "pam_orthosis"
    for part in place.split("."):
        name = f"{name}.{part}"
        if not hasattr(thing, part):
            import_module(name)
        thing = getattr(thing, part)
    return thing


def test_every_equation_is_cited_where_it_is_used(pages):
    found = equations.citations()
    assert list(found) == list(range(1, 38))
    assert [number for number, places in found.items() if not places] == []
    things = {place.place for places in found.values() for place in places}
    assert all(callable(_thing(place)) for place in things)
    assert [number for number, tests in equations.tests().items() if not tests] == []
    page = pages["reference/equations.md"]
    assert re.findall(r"^\| \((\d+)\) \| [^|]+ \| `", page, flags=re.M) == [str(n) for n in range(1, 38)]


def test_what_is_not_used_as_it_is_printed_is_listed(pages):
    mended = {min(equations.cited(one.words)) for one in equations.mended()}
    assert mended == {12, 14, 23, 25, 27, 31, 37}
    below = pages["reference/equations.md"].partition("## Not used as they are printed")[2]
    assert all(one.words in below for one in equations.mended())


def test_a_citation_is_found_in_ranges_and_lists():
    assert equations.cited("By Eqs. (14) and (16)-(18), and Eq. (25).") == {14, 16, 17, 18, 25}
    assert equations.cited("Equation 14, or (15).") == set()
    assert equations.sentence("Return F. It is linear, Eq. (14), in p. Eq. (27) too.", 14) == (
        "It is linear, Eq. (14), in p"
    )


def test_every_node_effect_verb_and_scenario_is_in_the_reference(pages):
    def names(folder):
        return {
            path.split("/")[-1].removesuffix(".md")
            for path in pages
            if path.startswith(f"reference/{folder}/")
        }

    assert names("nodes") == {"index", *nodes.executables()}
    assert names("effects") == {"index", *KNEE.catalogue}
    assert names("parameters") == {"index", "ankle", *parameters.SUBJECTS}
    assert re.findall(r"^## (\S+)$", pages["reference/cli.md"], flags=re.M) == list(VERBS)
    scenarios = re.findall(r"^\| `([\w-]+)` \|", pages["reference/scenarios.md"], flags=re.M)
    assert scenarios == list(parameters.scenario_names())


def test_every_key_of_a_machines_file_is_in_the_reference(pages):
    page = pages["reference/machine-file.md"]
    fields = [*machines.INLINE.values(), *TRANSMISSIONS.values()]
    fields += [one.fields for one in MECHANISMS.values()]
    for one in (one for some in fields for one in some):
        row = f"| `{one.name}` | {one.meaning} | {one.unit} | "
        assert row in page
    for key in (*machines.TOP, *machines.OF_ACTUATOR):
        assert f"| `{key}` | " in page


def test_who_reads_the_repository_is_told_what_builds_the_reference_of_machine_files(pages):
    assert "reference/machine-file.md" in pages
    text = (DOCS / "howto" / "machine.md").read_text(encoding="utf-8")
    assert "(../reference/machine-file.md), which `make docs` builds in `site`" in text


def test_a_recording_must_be_as_long_as_the_tutorial_says():
    short, p = Recording("short", 0.002, {"angle": np.zeros(1000)}), parameters.load()
    with pytest.raises(OrthosisError) as whole:
        check.check(knee(p), [short], p.gap.replay.warm_up)
    with pytest.raises(OrthosisError) as divided:
        check.check_divisible([short], HELD_SHARE, p.gap.replay.warm_up)
    least, undivided = (re.search(r"(\d+) s or more", str(one.value))[1] for one in (whole, divided))
    told = (DOCS / "tutorials" / "own-recordings.md").read_text(encoding="utf-8")
    assert (
        f"at least {least} s ({undivided} s without `--held-out`) and {check.LEAST_SAMPLES} samples" in told
    )


@pytest.mark.parametrize("module", nodes.executables())
def test_the_page_of_a_node_lists_the_parameters_that_the_node_has(pages, module):
    page = pages[f"reference/nodes/{module}.md"].partition("## Parameters")[2]
    shown_there = set(re.findall(r"^\| `([^`]+)` \|", page, flags=re.M))
    with declared.made(module, *declared.GIVEN.get(module, ())) as node:
        assert shown_there == set(node._parameters) - set(declared.OF_RCLPY)
    assert len(shown_there) < 60  # fits on a screen


def test_every_verb_has_examples_that_its_parser_takes():
    assert list(EXAMPLES) == list(ANSWERS) == list(VERBS)
    for verb, lines in EXAMPLES.items():
        assert lines
        for line in lines:
            program, first, *rest = line.split()
            assert (program, first) == ("pam-orthosis", verb)
            verb_parser(verb).parse_args(rest)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.line)
def test_every_command_is_one_that_the_program_takes(command):
    _, verb, *rest = command.line.split()
    if verb == "VERB" or "--help" in rest:
        return
    assert verb in VERBS
    verb_parser(verb).parse_args(rest)


def test_commands_are_found_in_their_order_and_each_once():
    first = shown.commands(DOCS / "tutorials" / "first-walk.md")
    assert [command.line for command in first[:2]] == [
        "pam-orthosis run --duration 10 --out walk",
        "pam-orthosis check walk",
    ]
    assert first[1].shown == "check.txt"
    lines = [command.line for command in shown.all_commands()]
    assert len(lines) == len(set(lines)) > 60
    (study,) = (c for c in shown.commands(DOCS / "howto" / "batches.md") if "study.yaml" in c.line)
    assert study.file[0] == "study.yaml"
    assert "grid:" in study.file[1]


def test_a_command_that_fails_is_counted(tmp_path, capsys):
    program = Path(sys.executable).with_name("pam-orthosis")
    failing = shown.Command("page", "pam-orthosis check nowhere")
    assert shown._carry_out(failing, tmp_path, program, keep=False)
    assert "exit 2" in capsys.readouterr().out
    other = shown.Command("page", "echo failed", shown="check.txt")
    assert shown._carry_out(other, tmp_path, program, keep=False)
    assert "does not end with 'PASSED" in capsys.readouterr().out


@pytest.mark.parametrize("picture", pictures.PAGES)
def test_a_picture_shows_the_verdict_that_stands_beside_it(picture):
    text = (shown.SHOWN / pictures.PAGES[picture][1]).read_text(encoding="utf-8")
    assert pictures.verdict_in(DOCS / "pictures" / picture) == text


def test_the_pages_by_hand_are_short():
    texts = (generate.BLOCK.sub("", page.read_text(encoding="utf-8")) for page in BY_HAND)
    words = sum(len(text.split()) for text in texts)
    assert 8_000 < words <= MOST_WORDS


def _made(line):
    """Return what a command makes: its --out, or the folder that an example is called."""
    if named := re.search(r" --out ([\w./-]+)", line):
        return named[1]
    example = re.match(r"pam-orthosis example (\w+)", line)
    return example[1] if example else ""


@pytest.mark.parametrize(
    "page", [*sorted((DOCS / "tutorials").glob("*.md")), ROOT / "README.md"], ids=lambda p: p.stem
)
def test_no_two_commands_of_a_page_make_the_same_folder(page):
    shell = re.findall(r"^(?: {4})?(pam-orthosis .*)$", page.read_text(encoding="utf-8"), flags=re.M)
    made = [name for line in shell if "--only table" not in line and (name := _made(line))]
    assert made
    assert len(made) == len(set(made)), made


def test_a_new_effect_is_one_file(monkeypatch):
    space = {}
    exec(examples()[0], space)
    (effect,) = space["EFFECTS"]
    monkeypatch.setitem(KNEE.catalogue, effect.name, effect)
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


def test_a_system_of_ones_own_is_one_file(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(examples()[2], encoding="utf-8")
    system = load_system(file)
    assert (system.inputs, list(system.catalogue)) == (
        ("current",),
        [
            "friction",
            "wrong_mass",
            "wrong_motor",
            "wrong_damping",
            "inputs_delay",
            "position_lag",
            "inputs_lag",
        ],
    )
    assert [equation.name for equation in system.equations] == ["dynamics"]
    assert system.places["friction"]


def test_another_controller_stands_in(capsys):
    exec(examples()[1], {})
    error = float(capsys.readouterr().out.split()[0])
    assert 0.0 < error < 0.1
