# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes is the same bag, and its errors arrive."""

import io
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from bags import ANGLE_TYPE, PERIOD_NS, serialised_angle
from pam_orthosis.bag import writer_process
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.recover import recover_in_place
from pam_orthosis.bag.writer_process import ON_DISK, READY, BagWriterProcess, serve
from pam_orthosis.errors import OrthosisError, RunFailed

TOPIC, RUN = "/joint_states", {"scenario": "test"}
STEPS = [[(TOPIC, k * PERIOD_NS, serialised_angle(k * PERIOD_NS, 0.01 * k))] for k in range(300)]


def filled(writer, steps=STEPS):
    writer.add_topic(TOPIC, ANGLE_TYPE)
    for step in steps:
        writer.write_all(step)
    return writer


def test_it_is_the_same_bag(tmp_path):
    for folder, kind in (("here", BagWriter), ("there", BagWriterProcess)):
        filled(kind(tmp_path / folder / "walk", RUN)).close()
    here, there = (sorted((tmp_path / name / "walk").iterdir()) for name in ("here", "there"))
    assert [file.name for file in there] == [file.name for file in here] != []
    assert [file.read_bytes() for file in there] == [file.read_bytes() for file in here]


def test_the_error_comes_with_a_later_call_and_again(tmp_path):
    filled(BagWriter(tmp_path, RUN)).close()
    writer = BagWriterProcess(tmp_path, RUN)
    for _ in range(2):
        with pytest.raises(OrthosisError, match="holds a bag already"):
            filled(writer, STEPS * 20).close()


def test_that_it_has_begun_or_cannot_is_known_before_anything_is_written(tmp_path):
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    assert _until(writer.ready)
    filled(writer).close()
    again = BagWriterProcess(tmp_path / "walk", RUN)
    with pytest.raises(OrthosisError, match="holds a bag already"):
        _until(again.ready)


def _until(true):
    deadline = time.monotonic() + 30
    while not true() and time.monotonic() < deadline:
        time.sleep(0.01)
    return true()


def test_what_others_print_and_signals_to_all_do_it_no_harm(tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("print('hello from site')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    assert _until(writer.ready)
    writer._process.terminate()
    filled(writer).close()
    assert read_bag(tmp_path / "walk", ["angle"]).run["scenario"] == "test"


def test_a_writer_that_stands_still_for_two_seconds_of_a_graph_holds_up_nobody(tmp_path):
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    assert _until(writer.ready)
    writer.add_topic(TOPIC, ANGLE_TYPE)
    rescue = threading.Timer(30, os.kill, (writer._process.pid, signal.SIGCONT))
    os.kill(writer._process.pid, signal.SIGSTOP)
    rescue.start()
    for k in range(400):  # 14 messages of this size a step
        writer.write_all([(TOPIC, k * PERIOD_NS, STEPS[0][0][2])] * 14)
    waited = not rescue.is_alive()
    rescue.cancel()
    os.kill(writer._process.pid, signal.SIGCONT)
    writer.close()
    assert not waited


def test_a_full_disk_is_told(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        writer = BagWriterProcess(tmp_path / "walk", RUN)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with pytest.raises(OrthosisError, match=r"cannot write .*walk_0.mcap: File too large"):
        filled(writer).close()


def test_a_writer_that_was_killed_is_told(tmp_path):
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    writer._process.kill()
    with pytest.raises(OrthosisError, match="bag_writer was killed by SIGKILL"):
        filled(writer).close()


def test_a_recorder_that_was_killed_at_once_leaves_nothing(tmp_path):
    sent, answers = pickle.dumps((str(tmp_path / "walk"), RUN)), []
    for length in (0, 9, len(sent) - 1):
        serve(io.BytesIO(sent[:length]), lambda *said: answers.append(said))
    assert answers == []
    assert not (tmp_path / "walk").exists()


@pytest.mark.parametrize("cut", [0, 7])
def test_what_came_before_the_recorder_was_killed_is_kept(tmp_path, cut):
    folder = tmp_path / "walk"
    said = [(str(folder), RUN), ("add_topic", TOPIC, ANGLE_TYPE, False), *(("write_all", s) for s in STEPS)]
    sent = b"".join(map(pickle.dumps, said))
    answers = []
    serve(io.BytesIO(sent[: len(sent) - cut]), lambda *said: answers.append(said))
    assert answers[0] == (READY,)
    assert {answer[0] for answer in answers[1:]} == {ON_DISK}
    assert recover_in_place(folder) == len(STEPS) - (cut > 0)
    angle = read_bag(folder, ["angle"])["angle"].value
    np.testing.assert_array_equal(angle, 0.01 * np.arange(len(STEPS) - (cut > 0)))


def stopped_and_seen(writer):
    os.kill(writer._process.pid, signal.SIGSTOP)
    _until(lambda: writer_process.stopped(writer._process.pid))


def stopped_and_not_seen(writer, monkeypatch):
    stopped_and_seen(writer)
    monkeypatch.setattr(writer_process, "stopped", lambda pid: False)
    monkeypatch.setattr(writer_process, "SILENCE_SECONDS", 0.3)


def stopped_then_killed(writer):
    stopped_and_seen(writer)
    os.kill(writer._process.pid, signal.SIGKILL)
    os.waitid(os.P_PID, writer._process.pid, os.WEXITED | os.WNOWAIT)


def killed(writer):
    writer._process.kill()


def _look_until_it_fails(writer):
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        writer.look()
        time.sleep(0.01)


def _assert_holds(folder, count):
    recover_in_place(folder)
    angle = read_bag(folder, ["angle"])["angle"]
    np.testing.assert_array_equal(angle.stamp_ns, PERIOD_NS * np.arange(count))
    np.testing.assert_array_equal(angle.value, 0.01 * np.arange(count))


@pytest.mark.parametrize("settled", [0, 130])
@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (killed, "was killed by SIGKILL"),
        (stopped_and_seen, r"was stopped \(SIGSTOP\)"),
        (stopped_then_killed, "was killed by SIGKILL"),
    ],
)
def test_a_writer_that_is_lost_is_named_and_nothing_is_lost(tmp_path, fault, named, settled):
    """What it had got, what was on its way and what comes afterwards, each once and in its order."""
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    assert _until(writer.ready)
    filled(writer, STEPS[:settled])
    _until(lambda: writer.look() or writer._on_disk.messages >= settled - 40)
    fault(writer)
    for step in STEPS[settled:200]:
        writer.write_all(step)
    with pytest.raises(RunFailed, match=f"bag_writer {named}"):
        _look_until_it_fails(writer)
    for step in STEPS[200:]:
        writer.write_all(step)
    with pytest.raises(RunFailed, match=f"bag_writer {named}"):
        writer.close()
    _assert_holds(tmp_path / "walk", len(STEPS))


def test_a_writer_that_does_not_answer_is_named_and_nothing_is_lost(tmp_path, monkeypatch):
    writer = BagWriterProcess(tmp_path / "walk", RUN)
    assert _until(writer.ready)
    filled(writer, STEPS[:100])
    stopped_and_not_seen(writer, monkeypatch)
    for step in STEPS[100:]:
        writer.write_all(step)
    with pytest.raises(RunFailed, match="bag_writer did not answer"):
        writer.close()
    _assert_holds(tmp_path / "walk", len(STEPS))


def test_who_records_waits_for_a_writer_that_is_far_behind_and_says_that_it_lives(tmp_path, monkeypatch):
    waited = []
    writer = BagWriterProcess(tmp_path / "walk", RUN, lambda: waited.append(len(writer._unsent)))
    assert _until(writer.ready)
    monkeypatch.setattr(writer_process, "WAITING_BYTES", 20_000)
    stopped_and_not_seen(writer, monkeypatch)
    rescue = threading.Timer(0.15, os.kill, (writer._process.pid, signal.SIGCONT))
    rescue.start()
    filled(writer, STEPS * 60).close()
    assert waited
    assert recover_in_place(tmp_path / "walk") == 60 * len(STEPS)


ORPHANED = """
import os, signal, sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_writer_process import RUN, STEPS, BagWriterProcess, _until, filled
writer = BagWriterProcess(Path({folder!r}), RUN)
assert _until(writer.ready)
os.kill(writer._process.pid, signal.SIGSTOP)
filled(writer)
writer._send()
print(writer._process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_writer_that_is_stopped_when_its_recorder_is_killed_writes_what_it_was_sent_and_ends(tmp_path):
    text = ORPHANED.format(tests=os.path.dirname(__file__), folder=str(tmp_path / "walk"))
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    pid = int(done.stdout)
    assert _until(lambda: not os.path.exists(f"/proc/{pid}"))
    _assert_holds(tmp_path / "walk", len(STEPS))
