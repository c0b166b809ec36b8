# SPDX-License-Identifier: Apache-2.0
"""What is said while work takes its time: what, how far, how long still; and nothing of short work."""

import io
import re
import threading
from pathlib import Path

import pytest

from pam_orthosis import progress
from pam_orthosis.bag.recover import recover
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import Shown, Watch, counted, part, shown

WALK = Path(__file__).parents[1] / "bags" / "walk"


class Terminal(io.StringIO):
    """A terminal that keeps what is printed on it."""

    def isatty(self):
        return True


class Clock:
    """Seconds that a test sets."""

    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_the_time_left_follows_from_what_is_done(clock):
    watch = Watch("loading", clock)
    clock.now = 3.0
    assert watch.line() == "loading, 3 s so far"
    watch("screening", 0, 10)
    assert watch.line() == "screening: 0 of 10, 3 s so far"  # of nothing done nothing follows
    clock.now = 11.0
    watch("screening", 2, 10)
    assert watch.line() == "screening: 2 of 10, about 32 s left"
    clock.now = 21.0
    assert watch.line() == "screening: 2 of 10, about 22 s left"
    clock.now = 60.0
    assert watch.line() == "screening: 2 of 10, 60 s so far"  # the estimate was too short


def test_another_amount_of_work_is_estimated_by_itself(clock):
    watch = Watch("reading", clock)
    watch("reading", 0, 4)
    clock.now = 100.0
    watch("reading", 4, 4)
    watch("fitting", 0, 4)  # as many again
    clock.now = 101.0
    watch("fitting", 1, 4)
    assert watch.line() == "fitting: 1 of 4, about 3 s left"


def test_long_times_and_amounts_with_a_unit(clock):
    watch = Watch("", clock)
    watch("copying", 0.0, 1000.0, " MB")
    clock.now = 10.0
    watch("copying", 12.34, 1000.0, " MB")
    assert watch.line() == "copying: 12.3 of 1000.0 MB, about 13 min left"


def test_parts_add_up():
    told = []
    whole = part(lambda *words: told.append(words), "recording", 20.0, 10.0, 40.0, " s")
    whole("compiling")
    whole("simulating", 5, 10)
    assert told == [("recording, compiling", 20.0, 40.0, " s"), ("recording", 25.0, 40.0, " s")]


def test_a_terminal_gets_one_line_rewritten_and_cleared(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    watch = Shown("reading " + 100 * "x")
    watch.show()
    watch.note("a bag is odd")
    watch("writing")
    watch.show()
    watch.end()
    assert all(len(re.sub(r"\x1b\[K", "", line)) <= progress.WIDEST for line in screen.getvalue().split("\r"))
    assert screen.getvalue().endswith("\r\x1b[K")
    lines = re.split(r"\r\x1b\[K|\n", screen.getvalue())
    assert [line[:7] for line in lines if line] == ["reading", "a bag i", "writing"]
    assert screen.getvalue().count("\n") == 1


def test_a_file_gets_lines(monkeypatch):
    log = io.StringIO()
    monkeypatch.setattr("sys.stderr", log)
    watch = Shown("reading")
    watch.show()
    watch("writing")
    watch.show()
    watch.end()
    assert [line.split(",")[0] for line in log.getvalue().splitlines()] == ["reading", "writing"]


def test_long_work_is_told_though_it_says_nothing_and_short_work_is_not(monkeypatch):
    monkeypatch.delenv(progress.OFF)
    printed = threading.Event()
    monkeypatch.setattr(Shown, "show", lambda _: printed.set())
    with shown("loading"):
        pass
    assert not printed.is_set()
    monkeypatch.setattr(progress, "PERIOD", 0.001)
    with shown("loading"):
        assert printed.wait(60.0)


def test_no_thread_is_left_and_a_closed_stderr_does_no_harm(monkeypatch):
    monkeypatch.delenv(progress.OFF)
    monkeypatch.setattr(progress, "PERIOD", 0.001)
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr("sys.stderr", closed)
    with pytest.raises(KeyError, match="mine"), shown("loading"):
        raise KeyError("mine")
    assert not [one for one in threading.enumerate() if one.name == "progress" and one.is_alive()]


def test_each_item_is_told_before_it_is_worked_on():
    told = []
    for item in counted("abc", lambda *words: told.append(words), "reading"):
        assert told[-1] == ("reading", "abc".index(item), 3)
    assert len(told) == 3


def test_a_simulation_tells_how_far_it_is(monkeypatch):
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    told = []
    ClosedLoop(load()).run(401, lambda *words: told.append(words[1:]))
    assert told == [(0, 401), (200, 401), (400, 401)]


def test_a_recovery_tells_both_passes_through_each_file(tmp_path):
    told = []
    recover(WALK, tmp_path / "new", lambda *words: told.append(words))
    shares = [done / of for _, done, of, _ in told]
    assert shares == sorted(shares)
    assert shares[0] < 0.01
    assert shares[-1] > 0.9
    assert {what for what, *_ in told} == {"looking for what is whole", "copying what is whole"}
