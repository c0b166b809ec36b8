# SPDX-License-Identifier: Apache-2.0
"""Long recordings are refused in words before they fill the memory."""

from types import SimpleNamespace

import pytest

from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.recordings import memory
from pam_orthosis.discrepancy.replay import store
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

LONG = [SimpleNamespace(samples=1_000_000), SimpleNamespace(samples=800_000)]


@pytest.fixture
def told(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "MEMORY", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "OWN", tmp_path / "own")
    monkeypatch.setattr(memory, "CONTAINER", tmp_path)
    return (tmp_path / "meminfo").write_text


@pytest.mark.parametrize(("free_kb", "said"), [(8_000_000, "every other row$"), (20_000_000, "--jobs 1$")])
def test_what_needs_more_than_is_free_is_refused(told, free_kb, said):
    told(f"MemTotal: 32000000 kB\nMemAvailable: {free_kb} kB\n")
    with pytest.raises(OrthosisError, match=rf"1,800,000 rows needs about 25\.2 GB .*{said}"):
        memory.check_room(LONG, 2)
    memory.check_room([SimpleNamespace(samples=60_000)], 2)


def test_where_a_system_does_not_say_what_is_free_nothing_is_refused(told):
    for tell in (lambda: None, lambda: told("MemTotal: 16000000 kB\n")):
        tell()
        assert memory.available() is None
        memory.check_room(LONG, 2)


@pytest.mark.parametrize("group", ["", "slice/own"])
@pytest.mark.parametrize(("line", "folder", "limit", "used", "dropped"), memory.GROUPS)
def test_the_limit_of_a_container_counts_where_it_is_lower(
    told, tmp_path, line, folder, limit, used, dropped, group
):
    """Be it the process's own, or one around it."""
    told("MemAvailable: 16000000 kB\n")
    (tmp_path / "own").write_text(f"9:pids:/\n{line if line == '0::' else f'4{line}'}/slice/own\n")
    place = tmp_path / folder / group
    place.mkdir(parents=True, exist_ok=True)
    statistics = "".join(f"{key} 500\n" for key in dropped)
    for name, text in ((limit, "4000000000"), (used, "3000000000"), ("memory.stat", f"anon 7\n{statistics}")):
        (place / name).write_text(f"{text}\n")
    assert memory.available() == 1_000_000_000 + 500 * len(dropped)
    (place / used).write_text("5000000000\n")
    assert memory.available() == 0
    (place / limit).write_text("max\n")
    assert memory.available() == 16_384_000_000


def test_a_search_asks(bench, told):
    told("MemAvailable: 1000 kB\n")
    with pytest.raises(OrthosisError, match="GB of memory"):
        begin(bench.system, [bench.recording(1)], [bench.recording(2)], load().gap)


def test_what_is_remembered_is_bounded_in_number_and_bytes(monkeypatch):
    kept = store.Store(3)
    monkeypatch.setattr(store, "MOST_BYTES", 100)
    for key in range(5):
        assert kept.keep((key,), SimpleNamespace(nbytes=60)).nbytes == 60
    assert [key for key in range(5) if kept.get((key,))] == [4]
    monkeypatch.setattr(store, "MOST_BYTES", 1000)
    for key in (*range(5), 4, 4):
        kept.keep((key, "of", key), SimpleNamespace(nbytes=60))
    assert [key for key in range(5) if kept.get((key, "of", key))] == [2, 3, 4]
    kept.forget(3)
    monkeypatch.setattr(store, "MOST_BYTES", 180)
    kept.keep((9,), SimpleNamespace(nbytes=60))  # what was forgotten, or kept anew, takes no room
    assert len(kept) == 3
