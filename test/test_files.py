# SPDX-License-Identifier: Apache-2.0
"""What is written is whole or not there at all, and nothing of anybody else's is removed or overwritten."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pam_orthosis import files, results
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.improvement import resumed

WALK = Path(__file__).resolve().parents[1] / "bags" / "walk"


def _state(folder):
    """Return all that is below a folder: names, what links point to, contents."""
    return {
        str(one.relative_to(folder)): os.readlink(one)
        if one.is_symlink()
        else one.is_file() and one.read_bytes()
        for one in sorted(folder.rglob("*"))
    }


def _full(stream):
    stream.write(b"half")
    raise OSError(28, "No space left on device")


def test_files_are_there_together_or_not_at_all(tmp_path):
    before = _state(tmp_path)
    first, second = tmp_path / "new" / "a.json", tmp_path / "new" / "deep" / "b.html"
    with pytest.raises(OrthosisError, match=r"b\.html: No space left"):
        files.write_files({first: files.as_text("a"), second: _full})
    assert _state(tmp_path) == before
    files.write_files({first: files.as_text("a"), second: files.as_text("b")})
    assert _state(tmp_path) == {"new": False, "new/a.json": b"a", "new/deep": False, "new/deep/b.html": b"b"}


def test_interrupted_writing_leaves_all_as_it_was(tmp_path):
    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        files.write_files({tmp_path / "new" / "page": interrupted})
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_somebody_makes_meanwhile_stays_his(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"

    def meanwhile(stream):
        stream.write(b"mine")
        second.write_text("theirs")

    with pytest.raises(OrthosisError, match="b exists"):
        files.write_files({first: files.as_text("a"), second: meanwhile})
    assert _state(tmp_path) == {"b": b"theirs"}


@pytest.fixture
def failing(monkeypatch):
    """Return a function: the name of the file that cannot take its place, though it could be written."""

    def at(name, error):
        replace = Path.replace

        def fails(part, path):
            if path.name == name:
                raise error
            return replace(part, path)

        monkeypatch.setattr(Path, "replace", fails)

    return at


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()])
@pytest.mark.parametrize("name", ["there", "new", "deep"])
def test_a_file_that_cannot_take_its_place_leaves_all_as_it_was(tmp_path, failing, name, error):
    """Be it in the place of another one, or new, which one that may be replaced can be, too."""
    there, new, deep = tmp_path / "there", tmp_path / "new", tmp_path / "folder" / "deep"
    there.write_text("before")
    failing(name, error)
    with pytest.raises((OrthosisError, KeyboardInterrupt)):
        files.write_files(dict.fromkeys((there, new, deep), files.as_text("after")), {there, new})
    assert _state(tmp_path) == {"there": b"before"}


def test_a_file_that_is_there_meanwhile_costs_none_that_is_replaced(tmp_path):
    there, new = tmp_path / "there", tmp_path / "new"
    there.write_text("before")

    def meanwhile(stream):
        stream.write(b"ours")
        new.write_text("theirs")

    with pytest.raises(OrthosisError, match="new exists"):
        files.write_files({there: files.as_text("after"), new: meanwhile}, {there})
    assert _state(tmp_path) == {"there": b"before", "new": b"theirs"}


def test_a_file_in_place_of_a_folder_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path / "file" / "page.html", tmp_path / "file" / "pictures" / "a.png"):
        with pytest.raises(OrthosisError, match="file is no folder; choose another --out"):
            files.refuse_existing([place], {place})


def test_a_path_that_is_too_long_leaves_no_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OrthosisError, match="name too long"):
        files.write_text(Path("new", "folder", 300 * "x", "model.yaml"), "ours")
    assert _state(tmp_path) == {}


@pytest.mark.parametrize("overwrite", [False, True])
def test_no_link_is_followed_and_none_is_replaced(tmp_path, overwrite):
    victim, link = tmp_path / "victim.txt", tmp_path / "model.yaml"
    victim.write_text("mine")
    link.symlink_to(victim)
    (tmp_path / ".model.yaml.part").symlink_to(victim)
    before = _state(tmp_path)
    with pytest.raises(OrthosisError, match=r"model\.yaml (exists|is no regular file)"):
        files.write_text(link, "ours", overwrite)
    assert _state(tmp_path) == before


def test_a_part_is_made_under_a_name_that_is_free(tmp_path, monkeypatch):
    """A link planted under the very name that the part would have is not followed."""
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: "guessed")
    (tmp_path / f"{files.UNFINISHED}guessed").symlink_to(victim)
    with pytest.raises(OrthosisError, match="exists"):
        files.write_text(tmp_path / "model.yaml", "ours")
    assert victim.read_text() == "mine"


def test_an_asked_for_overwriting_replaces_a_regular_file_and_fails_without_a_trace(tmp_path):
    file = tmp_path / "page.html"
    files.write_text(file, "before")
    with pytest.raises(OrthosisError, match="exists; choose another --out"):
        files.write_text(file, "after")
    with pytest.raises(OrthosisError, match="No space left"):
        files.write_files({file: _full}, {file})
    assert _state(tmp_path) == {"page.html": b"before"}
    files.write_text(file, "after", overwrite=True)
    assert _state(tmp_path) == {"page.html": b"after"}


def _half(out):
    with files.filled(out) as part:
        (part / "half").touch()
        raise ZeroDivisionError


@pytest.mark.parametrize("there", [True, False], ids=["an empty folder", "a new folder"])
def test_a_folder_is_filled_at_once_or_stays_as_it_was(tmp_path, there):
    out = tmp_path / "out"
    if there:
        out.mkdir()
    with pytest.raises(ZeroDivisionError):
        _half(out)
    assert out.exists() == there
    assert not there or list(out.iterdir()) == []
    with files.filled(out) as part:
        (part / "bag").mkdir()
        (part / "bag" / "bag_0.mcap").touch()
        assert part.name == "out"
    assert set(_state(out)) == {"bag", "bag/bag_0.mcap"}


def _fill_beside(out):
    with files.filled(out) as part:
        for name in ("a", "b"):
            (part / name).write_text("ours")
        (out / "b").write_text("theirs")


def test_what_somebody_puts_into_the_folder_meanwhile_stays(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(OrthosisError, match="exists"):
        _fill_beside(out)
    assert _state(tmp_path) == {"out": False, "out/b": b"theirs"}


def test_what_a_killed_process_left_unfinished_does_not_block_the_next(tmp_path):
    out = tmp_path / "out"
    code = (
        "import os, signal, sys; from pathlib import Path; from pam_orthosis.files import filled\n"
        "with filled(Path(sys.argv[1])) as part:\n"
        "    (part / 'half').touch(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, out], check=False)
    assert all(one.name.startswith(files.UNFINISHED) for one in out.iterdir())
    with files.filled(out) as part:
        (part / "whole").touch()
    assert (out / "whole").exists()


def test_a_used_folder_a_file_and_a_dangling_link_are_refused(tmp_path):
    used, file, link = (tmp_path / name for name in ("used", "file", "link"))
    used.mkdir()
    (used / "notes.txt").write_text("mine")
    file.write_text("mine")
    link.symlink_to(tmp_path / "nowhere")
    before = _state(tmp_path)
    for path in (used, file, link, file / "below", link / "below"):
        with pytest.raises(OrthosisError, match=r"not an empty folder|is no folder|Not a directory"):
            files.filled(path).__enter__()
    assert _state(tmp_path) == before


def test_a_link_to_an_empty_folder_is_a_folder(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with files.filled(tmp_path / "link") as part:
        (part / "bag").touch()
    assert (tmp_path / "there" / "bag").exists()


def test_results_are_added_to_and_replaced_but_nobody_elses(tmp_path):
    out = tmp_path / "out"
    results.write_results(out, {"a": files.as_text("1"), "deep/b": files.as_text("2")})
    results.refuse_foreign(out, ["c"])
    results.write_results(out, {"c": files.as_text("3")})
    results.write_results(out, {"deep/b": files.as_text("4")}, overwrite=True)
    assert (out / "deep" / "b").read_text() == "4"
    with pytest.raises(OrthosisError, match="a exists; choose another --out, or --overwrite"):
        results.write_results(out, {"a": files.as_text("5")})
    (out / "notes.txt").write_text("mine")
    (out / "c").write_text("mine")
    before = _state(tmp_path)
    for name in ("notes.txt", "c"):
        with pytest.raises(OrthosisError, match="not written by this, or changed since"):
            results.write_results(out, {"a": files.as_text("6"), name: files.as_text("ours")}, overwrite=True)
    with pytest.raises(OrthosisError, match=r"out holds notes\.txt"):
        results.refuse_foreign(out, ["new"], overwrite=True)
    with pytest.raises(OrthosisError, match="No space left"):
        results.write_results(out, {"a": _full}, overwrite=True)
    assert _state(tmp_path) == before


def test_a_state_of_something_else_is_told_as_such(tmp_path):
    (tmp_path / resumed.STATE).write_text('{"verb": "mine"}')
    with pytest.raises(OrthosisError, match=r"improve-state\.json was not written by `improve`"):
        resumed.begin(tmp_path, "digest", ())


# every verb that writes files or folders by names that are known before, and what it must leave alone
THERE = {
    "report": (["report", str(WALK), "--only", "table", "--out", "out"], "walk.csv"),
    "paper": (["paper", "--out", "out"], "pictures/force.png"),
    "rig": (["rig", "--out", "out"], "notes.txt"),
    "improve": (["improve", "--out", "out"], "notes.txt"),
    "gap": (["gap", str(WALK), "--out", "out"], "model.yaml"),
    "gap-hide": (["gap-hide", "--out", "out"], "notes.txt"),
    "plan": (["plan", "--out", "out/plan.yaml"], "plan.yaml"),
    "recover": (["recover", str(WALK), "--out", "out"], "notes.txt"),
    "a result": (["batch", "check", str(WALK), "--out", "out"], "walk/result.json"),
    "a unit": (["batch", "check", str(WALK), "--out", "out"], "walk/notes.txt"),
    "gap beside something": (["gap", str(WALK), "--out", "out"], "notes.txt"),
    "report beside something": (["report", str(WALK), "--out", "out"], "notes.txt"),
    "report again": (["report", str(WALK), "--out", "out", "--overwrite"], "walk.html"),
    "paper again": (["paper", "--out", "out", "--overwrite"], "paper.html"),
    "figures": (["identify", "table.csv", "--figures", "out"], "force.png"),
    "a page": (["batch", "check", str(WALK), "--out", "out"], "batch.html"),
    "batch beside something": (["batch", "check", str(WALK), "--out", "out"], "notes.txt"),
    "a summary": (["batch", "check", str(WALK), "--out", "out"], "batch.json"),
}


@pytest.mark.parametrize("linked", [False, True], ids=["a file", "a link"])
@pytest.mark.parametrize("what", THERE)
def test_no_verb_overwrites_or_removes_what_is_there(tmp_path, monkeypatch, capsys, what, linked):
    monkeypatch.chdir(tmp_path)
    arguments, name = THERE[what]
    file, victim = tmp_path / "out" / name, tmp_path / "victim"
    file.parent.mkdir(parents=True)
    victim.write_text("mine")
    if linked:
        file.symlink_to(victim)
    else:
        file.write_text("mine")
    before = _state(tmp_path)
    assert main(arguments) == 2
    assert _state(tmp_path) == before
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert re.search(r"another --(out|figures)", said)


def test_a_report_is_made_again_only_if_that_is_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["report", str(WALK), "--only", "table"]
    assert main(command) == 0
    assert capsys.readouterr().out == "walk-report/walk.csv\n"
    table = tmp_path / "walk-report" / "walk.csv"
    made = table.read_bytes()
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "walk-report exists" in said
    assert "or --overwrite to make it again" in said
    os.utime(table, (0, 0))
    assert main([*command, "--overwrite"]) == 0
    assert table.read_bytes() == made
    assert table.stat().st_mtime > 0
    table.write_text("edited")
    assert main([*command, "--overwrite"]) == 2
    assert "changed since; choose another --out" in capsys.readouterr().err
    assert table.read_text() == "edited"


IMPOSSIBLE = {
    "gap-hide": ["gap-hide", "--effect", "none"],
    "plan": ["plan"],
    "paper": ["paper"],
    "gap": ["gap", str(WALK)],
    "report": ["report", str(WALK)],
    "batch": ["batch", "check", str(WALK)],
    "improve": ["improve"],
    "margin": ["margin"],
    "rig": ["rig"],
    "recover": ["recover", str(WALK)],
    "example": ["example", "walk"],
}


@pytest.mark.parametrize(
    "place", ["/proc/new/out", f"{300 * 'x'}/out"], ids=["no writing", "too long a name"]
)
@pytest.mark.parametrize("verb", IMPOSSIBLE)
def test_a_place_that_cannot_be_written_is_told_before_the_work(verb, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for maker in ("testing.case.make_case", "planning.plan.make_plan"):
        monkeypatch.setattr(f"pam_orthosis.{maker}", lambda *_, **__: pytest.fail("the work has begun"))
    assert main([*IMPOSSIBLE[verb], "--out", place]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "cannot write" in said or "name too long" in said
    assert not list(tmp_path.iterdir())
