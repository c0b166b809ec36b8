# SPDX-License-Identifier: Apache-2.0
"""Input that is made to cost much: one line, exit status 2, at most 1 GiB and 5 s of work."""

import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import casadi as ca
import pytest
from hostile import BOMB, GIB, MIB, MOST_MEMORY, MOST_WORK_S, bag, command, commands, zeros

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import compiled
from pam_orthosis.model.parameters import config_folder
from pam_orthosis.reading import from_json, from_yaml

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"
NESTED = {"20,000 lists": "[" * 20_000, "50,000 lists": "[" * 50_000, "50,000 mappings": "{a: " * 50_000}
SPOILT = {
    **NESTED,
    "aliases": BOMB,
    "itself": "a: &a {b: *a}\n",
    "no text": b"a: \xff\n",
    "a number": "a: 9" + "9" * 5000,
}
IN_A_LINE = {
    "aliases": "{" + BOMB.replace("\n", ", ") + "}",
    "lists": "[" * 50_000,
    "mappings": "{a: " * 20_000,
}


def refused(*arguments, names=(), **options):
    """Check that a command refuses, in one line that names what it is about, within the bounds."""
    return all_refused({tuple(arguments): names}, **options)[0]


def all_refused(calls, **options):
    """Check it of several commands, each with what its line names; one process runs them: that is faster."""
    lines = []
    for (call, names), ended in zip(calls.items(), commands(calls, **options), strict=True):
        assert ended.status == 2, (call, ended)
        assert len(ended.lines) == 1, (call, ended)
        assert ended.lines[0].startswith("pam-orthosis: error: "), (call, ended)
        for name in names:
            assert str(name) in ended.lines[0], call
        within_bounds(ended)
        lines += ended.lines
    return lines


def within_bounds(ended):
    assert ended.memory < MOST_MEMORY, ended
    assert ended.work_s < MOST_WORK_S, ended


def test_a_chunk_that_unpacks_to_5_gib(tmp_path):
    file, out = bag(tmp_path / "bomb.mcap", zeros(5 * GIB), 5 * GIB), tmp_path / "out"
    assert file.stat().st_size < MIB
    calls = [(verb, file) for verb in ("check", "identify", "gap")]
    calls += [("report", file, "--out", out), ("plan", "--after", file, "--out", tmp_path / "plan.yaml")]
    all_refused({call: [file] for call in calls})
    assert not out.exists()
    ended = command("recover", file, "--out", out)  # which keeps what is whole
    assert ended.status == 0
    within_bounds(ended)


def test_a_chunk_that_says_less_than_it_unpacks_to(tmp_path):
    refused("check", bag(tmp_path / "bomb.mcap", zeros(5 * GIB), 1000), names=["bomb.mcap", "another size"])


def test_many_chunks_within_the_bound_of_one(tmp_path):
    file = bag(tmp_path / "bomb.mcap", zeros(200 * MIB), 200 * MIB)
    assert "no record" in refused("check", file, names=[file])


def test_a_message_that_says_3_gib(tmp_path):
    file = tmp_path / "said.mcap"
    data = (WALK / "walk_0.mcap").read_bytes()
    file.write_bytes(data[:-37] + struct.pack("<BQ", 5, 3 * GIB) + data[-37:])
    refused("check", file, names=[file])


def test_a_message_of_3_gib(tmp_path):
    file = tmp_path / "long.mcap"
    head = (WALK / "walk_0.mcap").read_bytes()[:200]
    at = 8 + 9 + struct.unpack_from("<Q", head, 9)[0]
    end = struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + b"\x89MCAP0\r\n"
    with open(file, "wb") as stream:  # a file with a hole takes no disk
        stream.write(head[:at] + struct.pack("<BQ", 5, 3 * GIB))
        stream.seek(3 * GIB, os.SEEK_CUR)
        stream.write(end)
    all_refused({(verb, file): [file, "3.0 GiB"] for verb in ("check", "identify", "gap")})


def test_what_is_beside_a_message_of_3_gib_is_recovered(tmp_path):
    data, file = (WALK / "walk_0.mcap").read_bytes(), tmp_path / "long.mcap"
    at = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    with open(file, "wb") as stream:
        stream.write(data[:at] + struct.pack("<BQ", 5, 3 * GIB))
        stream.seek(3 * GIB, os.SEEK_CUR)
        stream.write(data[at:])
    ended = command("recover", file, "--out", tmp_path / "out")
    assert ended.status == 0
    within_bounds(ended)
    assert command("check", tmp_path / "out").status == 0


def test_a_hole_in_place_of_records(tmp_path):
    file = tmp_path / "hole.mcap"
    data = (WALK / "walk_0.mcap").read_bytes()
    with open(file, "wb") as stream:
        stream.write(data[:8])
        stream.seek(3 * GIB)
        stream.write(data[-37:])
    refused("check", file, names=[file])


def test_quality_of_service_in_a_bag(tmp_path):
    qualities = [BOMB, *NESTED.values()]
    files = [bag(tmp_path / f"{n}.mcap", b"", 0, "", quality) for n, quality in enumerate(qualities)]
    all_refused({("check", file): [file] for file in files})


def test_the_metadata_of_a_folder(tmp_path):
    folders = [Path(shutil.copytree(WALK, tmp_path / what)) for what in SPOILT]
    for folder in folders:
        _write(folder / "metadata.yaml", SPOILT[folder.name])
    all_refused({("check", folder): [folder] for folder in folders})


@pytest.mark.parametrize("verb", ["gap", "run", "plan", "study"])
def test_files_that_people_write(verb, tmp_path):
    if verb == "run":
        pytest.importorskip("rclpy")
    files = [tmp_path / f"{what}.yaml" for what in SPOILT]
    for file in files:
        _write(file, SPOILT[file.stem])
    arguments = {
        "gap": ["gap", WALK, "--model"],
        "run": ["run", "--out", tmp_path / "out", "--model"],
        "plan": ["plan", "--out", tmp_path / "plan.yaml", "--model"],
        "study": ["batch", "--out", tmp_path / "out", "study"],
    }
    all_refused({(*arguments[verb], file): [file] for file in files})


def test_parameters_on_the_command_line(tmp_path):
    key, out = "leg.shank.length", tmp_path / "plan.yaml"
    all_refused({("plan", "--param", f"{key}={text}", "--out", out): [key] for text in IN_A_LINE.values()})


def test_a_scenario_file_with_a_bomb(tmp_path):
    shutil.copytree(config_folder(), tmp_path / "config")
    _write(tmp_path / "config" / "scenario.yaml", BOMB)
    ours = "from pathlib import Path; from pam_orthosis.model import parameters;"
    code = f"{ours} parameters.config_folder = lambda: Path('config'); parameters.scenario_names()"
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "OrthosisError: config/scenario.yaml is not valid YAML: more than" in done.stderr


@pytest.mark.parametrize("text", ["[" * 50_000, '{"a":' * 50_000, '{"a": 1, "a": 2}', "9" * 5000])
def test_json(text):
    with pytest.raises(OrthosisError, match="told is not valid JSON"):
        from_json(text, "told")
    assert from_json('{"a": "[[\\"[["}', "told") == {"a": '[["[['}


def test_a_few_aliases_are_read():
    assert from_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\n", "file") == {"a": {"x": 1}, "b": {"x": 1, "y": 2}}
    with pytest.raises(OrthosisError, match="file is not valid YAML: 'a' is there twice"):
        from_yaml("a: 1\na: 2\n", "file")


STUDIES = {
    "grid": {
        "grid": {f"leg.{key}": [1.0] * 10_000 for key in ("person.mass", "person.height", "shank.mass")}
    },
    "draws": {"random": {"count": 300_000_000, "between": {"leg.person.mass": [60, 80]}}},
    "beyond": {"random": {"count": 10**30, "between": {"leg.person.mass": [60, 80]}}, "seeds": [1, 2]},
}


def test_studies_of_too_many_walks(tmp_path):
    for name, study in STUDIES.items():
        (tmp_path / name).write_text(json.dumps(study))
    files = [tmp_path / name for name in STUDIES]
    all_refused({("batch", "study", file, "--out", tmp_path / "out"): [file, "walks"] for file in files})


VERBS = {
    "check": ["check", "{}"],
    "report": ["report", "{}", "--out", "out"],
    "recover": ["recover", "{}", "--out", "out"],
    "identify": ["identify", "{}"],
    "gap": ["gap", "{}"],
    "gap --model": ["gap", str(WALK), "--model", "{}"],
    "plan --model": ["plan", "--model", "{}", "--out", "plan.yaml"],
    "plan --after": ["plan", "--after", "{}", "--out", "plan.yaml"],
    "study": ["batch", "study", "{}", "--out", "out"],
}


ENDINGS = {
    "identify": ".csv",
    "report": ".db3",
    "gap --model": ".yaml",
    "plan --model": ".yaml",
    "study": ".yaml",
}


@pytest.mark.parametrize("what", ["pipe", "device"])
def test_a_pipe_or_a_device_in_place_of_a_file(what, tmp_path):
    calls = {}
    for number, (verb, words) in enumerate(VERBS.items()):
        file = tmp_path / f"data{number}{ENDINGS.get(verb, '.mcap')}"
        if what == "pipe":
            os.mkfifo(file)
        else:
            file.symlink_to("/dev/zero")
        calls[tuple(word.replace("{}", file.name) for word in words)] = file.name
    lines = all_refused(dict.fromkeys(calls, ()), cwd=tmp_path)
    for name, line in zip(calls.values(), lines, strict=True):
        assert name in line or "/dev/zero" in line


@pytest.mark.parametrize("verb", ["check", "identify", "plan --model"])
def test_what_is_typed_in_place_of_a_file(verb, tmp_path):
    read, write = os.pipe()  # that nobody writes to
    try:
        refused(*(word.replace("{}", "/dev/stdin") for word in VERBS[verb]), stdin=read, cwd=tmp_path)
    finally:
        os.close(read)
        os.close(write)


def test_a_folder_and_a_loop_of_links_in_place_of_a_file(tmp_path):
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "loop.yaml").symlink_to(tmp_path / "loop.yaml")
    names = ("folder.yaml", "loop.yaml")
    all_refused({("plan", "--model", tmp_path / name, "--out", tmp_path / "x"): [name] for name in names})


@pytest.mark.parametrize("name", ["metadata.yaml", "walk_0.mcap"])
def test_a_pipe_within_a_bag(name, tmp_path):
    shutil.copytree(WALK, tmp_path / "bag")
    (tmp_path / "bag" / name).unlink()
    os.mkfifo(tmp_path / "bag" / name)
    refused("check", tmp_path / "bag", names=[name])


def test_a_table_that_is_too_long(tmp_path):
    files = {"identify": tmp_path / "dmsp20.csv", "gap": tmp_path / "knee.csv"}
    for verb, file in files.items():
        with open(file, "wb") as stream:
            stream.write(b"p_Pa_gauge,L_m,F_N\n" if verb == "identify" else b"time,angle\n")
            stream.truncate(3 * GIB)
    all_refused({(verb, file): [file] for verb, file in files.items()})


def _write(file, content):
    file.write_bytes(content if isinstance(content, bytes) else content.encode())


MODELS = {
    "leg.shank.lenght: 0.4\n": "leg.shank.lenght",
    "leg.shank.length: long\n": "leg.shank.length",
    "leg.shank.length: .nan\n": "leg.shank.length",
    "leg.shank.length: 1.0e+9\n": "leg.shank.length",
    f"leg.shank.length: 0x{'f' * 50_000}\n": "leg.shank.length",
    "leg.joint.minimum: 1.0\nleg.joint.maximum: 0.9\n": "leg.joint",
    "leg.shank.length: 0.4\nleg: {shank: {length: 0.4}}\n": "leg.shank.length",
    "muscle.dmsp_20.force.a: [.inf, 1.0, 1.0, 1.0]\n": "muscle.dmsp_20.force.a",
}


def test_a_model_is_refused_by_name_and_key(tmp_path):
    calls = {}
    for number, (text, key) in enumerate(MODELS.items()):
        file = tmp_path / f"model{number}.yaml"
        file.write_text(text)
        for words in (("gap", WALK), ("plan", "--out", "plan.yaml")):
            calls[(*words, "--model", file)] = [file, key]
    all_refused(calls, cwd=tmp_path)


@pytest.fixture
def cache(tmp_path, monkeypatch, compiler):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PAM_ORTHOSIS_NO_COMPILER", raising=False)
    compiled._tell_once.cache_clear()
    return tmp_path / "pam_orthosis"


def square():
    x = ca.SX.sym("x")
    return compiled.compiled(ca.Function("square", [x], [x**2]))(3.0)[0][0]


@pytest.mark.parametrize("mode", [0o770, 0o777])
@pytest.mark.parametrize("what", ["folder", "file"])
def test_machine_code_that_others_can_write_is_not_loaded(what, mode, cache, capsys, monkeypatch):
    assert square() == 9.0
    (library,) = cache.glob("*.so")
    before = library.read_bytes()
    (cache if what == "folder" else library).chmod(mode)
    monkeypatch.setattr(compiled, "loads", lambda _: pytest.fail("loaded"))
    assert square() == square() == 9.0
    (line,) = capsys.readouterr().err.splitlines()
    assert str(cache if what == "folder" else library) in line
    assert library.read_bytes() == before


@pytest.mark.parametrize("what", ["folder", "file"])
def test_machine_code_of_another_user_is_not_loaded(what, cache, capsys, monkeypatch):
    assert square() == 9.0
    (library,) = cache.glob("*.so")
    if os.geteuid():
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    else:
        os.chown(cache if what == "folder" else library, 12345, 12345)
    monkeypatch.setattr(compiled, "loads", lambda _: pytest.fail("loaded"))
    assert square() == 9.0
    (line,) = capsys.readouterr().err.splitlines()
    assert "of another user" in line


def test_a_cache_on_a_disk_that_runs_no_program(cache, capsys):
    cache.mkdir(mode=0o700)
    mount = ["mount", "-t", "tmpfs", "-o", "noexec,mode=700", "none", cache]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        assert square() == square() == 9.0
    finally:
        subprocess.run(["umount", cache], check=True)
    (line,) = capsys.readouterr().err.splitlines()
    assert "noexec" in line


def test_a_library_that_cannot_be_loaded_once_built(cache, capsys, monkeypatch):
    """As on a disk that does not say that it runs no program."""
    monkeypatch.setattr(compiled, "loads", lambda _: False)
    assert square() == 9.0
    assert "lets no program run" in capsys.readouterr().err
