# SPDX-License-Identifier: Apache-2.0
"""The cache of machine code: whatever is in it or becomes of it, functions work."""

import fcntl
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from types import SimpleNamespace

import casadi as ca
import pytest
from numpy.random import bit_generator

from pam_orthosis.model import compiled as module
from pam_orthosis.model.compiled import compiled

SOURCE, FLAGS = "int one(void) { return 1; }", ("-shared", "-fPIC")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PAM_ORTHOSIS_NO_COMPILER", raising=False)
    return tmp_path / "pam_orthosis"


def square():
    x = ca.SX.sym("x")
    return ca.Function("square", [x], [x**2])


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("content", [b"", b"\x7fELF cut short"])
def test_a_library_that_was_cut_short_is_built_anew(cache, content):
    assert compiled(square())(3.0)[0][0] == 9.0
    (library,) = cache.glob("*.so")
    library.unlink()
    library.write_bytes(content)
    assert compiled(square())(3.0)[0][0] == 9.0
    (library,) = cache.glob("*.so")
    assert library.stat().st_size > 1000


@pytest.fixture
def built(cache):
    """Return a library in the cache, and the place of the note on the key `key`; any that loads will do."""
    cache.mkdir(mode=0o700)
    library = cache / f"square_{20 * '0'}.so"
    shutil.copy(bit_generator.__file__, library)
    library.chmod(0o700)
    return library, module._note(cache, "square", "key")


def test_a_library_is_found_by_its_key_again(built):
    library, _ = built
    assert module.remembered("square", "key") is None
    module.remember("square", "key", library)
    assert module.remembered("square", "key") == library
    assert sorted(library.parent.iterdir()) == sorted(built)
    assert module.remembered("square", "another key") is None


def test_what_is_in_the_place_of_a_note_stays(built):
    library, note = built
    note.write_text("somebody's", encoding="utf-8")
    module.remember("square", "key", library)
    assert note.read_text(encoding="utf-8") == "somebody's"
    assert module.remembered("square", "key") is None


@pytest.mark.parametrize("name", ["mine.so", "../mine.so", "other_00000000000000000000.so"])
def test_a_note_that_names_another_file_is_not_followed(built, name):
    library, note = built
    other = library.parent / name
    other.write_text("no machine code", encoding="utf-8")
    other.chmod(0o700)
    note.write_text(name, encoding="utf-8")
    note.chmod(0o600)
    assert module.remembered("square", "key") is None
    assert other.read_text(encoding="utf-8") == "no machine code"


def test_a_note_that_is_a_link_is_not_followed(built, tmp_path):
    library, note = built
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text(library.name, encoding="utf-8")
    note.symlink_to(elsewhere)
    assert module.remembered("square", "key") is None


@pytest.mark.usefixtures("compiler")
def test_where_nothing_can_be_written_the_virtual_machine_computes(cache, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_compile", full)
    assert compiled(square())(3.0)[0][0] == 9.0
    assert list(cache.glob("*.so")) == []


@pytest.mark.usefixtures("compiler", "cache")
def test_what_another_process_builds_is_waited_for_and_not_built_twice(monkeypatch):
    """The first one begins; the second one must not, until the first has ended."""
    built, begun, waiting, go_on = [], Event(), Event(), Event()
    build = module._compile

    def look(_):
        waiting.set()
        first.result(60)

    def slow(command, source, library):
        built.append(library.name)
        begun.set()
        assert go_on.wait(60)
        return build(command, source, library)

    monkeypatch.setattr(module, "_compile", slow)
    with ThreadPoolExecutor(2) as both:
        first = both.submit(module.shared_library, "one", SOURCE, FLAGS)
        assert begun.wait(60)
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=time.monotonic, sleep=look))
        second = both.submit(module.shared_library, "one", SOURCE, FLAGS)
        assert waiting.wait(60)
        go_on.set()
        libraries = [one.result(60) for one in (first, second)]
    assert len(built) == 1
    assert libraries[0] == libraries[1]
    assert [path.name for path in libraries[0].parent.iterdir()] == [libraries[0].name]


@pytest.mark.usefixtures("compiler", "cache")
def test_a_process_that_builds_for_ever_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    library = module.shared_library("one", SOURCE, FLAGS)
    library.unlink()
    lock = library.with_suffix(".lock")
    with open(lock, "w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert module.shared_library("one", SOURCE, FLAGS) == library
        assert lock.exists(), "it is the other one's"
    assert library.exists()


def test_a_compiler_that_does_not_end_is_stopped(cache, tmp_path, monkeypatch, capsys):
    program = tmp_path / "gcc"
    program.write_text("#!/bin/sh\nexec sleep 1000\n")
    program.chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "")
    monkeypatch.setattr(module, "COMPILER_S", 0.5)
    assert module.best_library("one", SOURCE, FLAGS, [("-O2",), ()]) is None
    assert os.environ["PAM_ORTHOSIS_NO_COMPILER"], "the next function would wait as long"
    assert f"{program} does not end" in capsys.readouterr().err
    assert not list(cache.iterdir())


@pytest.mark.usefixtures("compiler", "cache")
@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_a_file_that_a_build_did_not_create_stays(monkeypatch, when):
    library = module.shared_library("one", SOURCE, FLAGS)
    library.unlink()
    lock, build = library.with_suffix(".lock"), module._compile

    def replaced(*arguments):
        if when == "meanwhile":
            lock.unlink()
            lock.write_text("somebody's")
        return build(*arguments)

    if when == "before":
        lock.write_text("somebody's")
    monkeypatch.setattr(module, "_compile", replaced)
    assert module.shared_library("one", SOURCE, FLAGS) == library
    assert lock.read_text() == "somebody's"
