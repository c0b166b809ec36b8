# SPDX-License-Identifier: Apache-2.0
"""What asks a command to end does so in one line, at whatever stage it is, and once."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from own_domain import own_domain

from pam_orthosis.cli import main as entry
from pam_orthosis.errors import OrthosisError, RunFailed

ROOT = Path(__file__).resolve().parents[2]
HEED = ["env", "--default-signal=HUP,INT,TERM"]
CLI = "pam_orthosis.cli.main"
WALK = str(ROOT / "bags" / "walk")
VERBS = {
    "check": [WALK],
    "report": [WALK],
    "recover": [WALK],
    "replay": [WALK],
    "gap": [WALK],
    "identify": [WALK],
    "batch": ["check", WALK],
    "paper": [],
    "rig": [],
    "improve": [],
    "plan": [],
    "margin": [],
    "gap-hide": [],
    "run": [],
}


def _interrupted(folder, module, arguments, at, by="SIGINT", within=()):
    environment = {**os.environ, "INTERRUPT_AT": at, "INTERRUPT_BY": by}
    places = [str(Path(__file__).parent / "interrupting"), os.environ.get("PYTHONPATH")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, places))
    command = [*HEED, *within, sys.executable, "-m", module, *arguments]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("verb", "at"),
    [*((verb, "") for verb in VERBS), ("check", "numpy"), ("gap", "scipy.linalg"), ("rig", "casadi")],
)
def test_a_verb_that_is_interrupted_while_it_loads_says_so_in_one_line(tmp_path, verb, at):
    out = [] if verb in ("check", "replay", "identify") else ["--out", "out"]
    at = at or f"pam_orthosis.cli.{verb.replace('-', '_')}"
    done = _interrupted(tmp_path, CLI, [verb, *VERBS[verb], *out], at)
    assert (done.returncode, done.stderr) == (3, "pam-orthosis: interrupted\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("by", ["SIGHUP", "SIGTERM"])
def test_all_signals_that_ask_for_an_end_do_the_same(tmp_path, by):
    done = _interrupted(tmp_path, CLI, ["check", WALK], "numpy", by)
    assert (done.returncode, done.stderr) == (3, "pam-orthosis: interrupted\n")


@pytest.mark.parametrize("node", ["position_controller", "bag_recorder", "composed", "dummy_driver"])
@pytest.mark.parametrize("at", ["rclpy", "numpy"])
def test_a_node_that_is_interrupted_while_it_loads_says_so_in_one_line(tmp_path, node, at):
    pytest.importorskip("rclpy")
    done = _interrupted(tmp_path, "pam_orthosis.nodes.entry", [node], at)
    assert (done.returncode, done.stderr) == (3, "pam-orthosis: error: interrupted while it was started\n")


def test_an_interrupted_node_that_cannot_say_so_has_the_same_exit_status(tmp_path):
    pytest.importorskip("rclpy")
    closed = ["sh", "-c", 'exec "$@" 2>&-', "sh"]
    done = _interrupted(tmp_path, "pam_orthosis.nodes.entry", ["bag_recorder"], "numpy", within=closed)
    assert (done.returncode, done.stdout) == (3, "")


@pytest.mark.parametrize("at", ["rclpy", "numpy"])
def test_a_node_that_is_asked_to_end_while_it_loads_does(tmp_path, at):
    pytest.importorskip("rclpy")
    done = _interrupted(tmp_path, "pam_orthosis.nodes.entry", ["position_controller"], at, "SIGTERM")
    assert (done.returncode, done.stderr) == (0, "")


MADE = """
import os, sys
from pam_orthosis.nodes import position_controller, process
process.leave = lambda nodes: print("left", [node.role for node in nodes])
sys.exit(process.run(lambda: os.kill(os.getpid(), 15) or [position_controller.PositionControllerNode()]))
"""


def test_a_node_that_is_asked_to_end_while_it_is_made_leaves_the_middleware(tmp_path):
    pytest.importorskip("rclpy")
    environment = {**os.environ, "ROS_LOG_DIR": str(tmp_path), "ROS_DOMAIN_ID": str(own_domain())}
    command = [*HEED, sys.executable, "-u", "-c", MADE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "left ['position_controller']\n")


def test_what_is_ignored_from_the_start_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        entry._catch_signals({})
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("first", [KeyboardInterrupt(), RunFailed("node x was killed by SIGKILL")])
def test_what_comes_while_the_end_is_dealt_with_changes_nothing(first):
    try:
        try:
            raise first
        except BaseException:
            raise OSError("the disk is full")  # noqa: B904
    except OSError:
        entry._interrupt(signal.SIGINT, None)


def test_another_failure_that_is_dealt_with_can_be_interrupted(monkeypatch):
    monkeypatch.setattr(entry, "_over", [])
    monkeypatch.setattr(entry, "_interrupted", [])
    try:
        raise OrthosisError("one of many")
    except OrthosisError:
        with pytest.raises(KeyboardInterrupt):
            entry._interrupt(signal.SIGINT, None)


def test_what_a_module_in_c_makes_of_an_interruption_is_told_as_one(monkeypatch, capsys):
    def dispatch(_arguments):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("numpy.core.multiarray failed to import") from None

    monkeypatch.setattr(entry, "_dispatch", dispatch)
    assert entry.main([]) == 3
    assert capsys.readouterr().err == "pam-orthosis: interrupted\n"


def test_a_signal_that_is_swallowed_comes_again(monkeypatch, capsys):
    def deaf(_arguments):
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10.0)
        for _ in range(3000):
            time.sleep(0.01)
        return 0

    monkeypatch.setattr(entry, "_dispatch", deaf)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        assert entry.main([]) == 3
    finally:
        signal.signal(signal.SIGINT, before)
    assert "interrupted" in capsys.readouterr().err


def _twice(_arguments):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(1.0)


def _refusing(_arguments):
    raise OrthosisError("one of many")


def _signalled_at(number, by):
    """Let `main` get a signal before the instruction of this number of its module; return whether it did."""
    left = [number]

    def at(frame, event, _):
        if frame.f_code.co_filename != entry.__file__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and frame.f_lineno:  # no signal is dealt with in the few of no line
            left[0] -= 1
            if left[0] == 0:
                signal.raise_signal(by)
        return at

    sys.settrace(at)
    try:
        status = entry.main()
    except KeyboardInterrupt:
        pytest.fail("it came out as a traceback")
    finally:
        sys.settrace(None)
    return status, left[0] <= 0


@pytest.mark.parametrize(
    ("work", "by", "statuses"),
    [
        (lambda _: 0, signal.SIGTERM, {0, 3}),
        (_refusing, signal.SIGTERM, {2, 3}),
        (_twice, signal.SIGTERM, {3}),
        (_twice, signal.SIGALRM, {3}),
    ],
    ids=["good", "refused", "twice", "again"],
)
def test_at_whatever_instruction_a_signal_comes_there_is_one_line_and_a_status(
    work, by, statuses, monkeypatch, capsys
):
    monkeypatch.setattr(entry, "_dispatch", work)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGALRM)}
    number, came, seen = 5, True, set()  # behind what comes before its `try`
    try:
        while came:
            for one in before:
                heard = one == signal.SIGTERM
                signal.signal(one, signal.default_int_handler if heard else signal.SIG_IGN)
            status, came = _signalled_at(number, by)
            assert capsys.readouterr().err.count("\n") == (status != 0)
            seen.add(status)
            number += 1
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    assert seen == statuses
    assert number > 50
