# SPDX-License-Identifier: Apache-2.0
"""The supervisor against processes that are no nodes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pam_orthosis import processes
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes import process, supervisor
from pam_orthosis.nodes.supervisor import supervise

STEPPING = """
import os, time
pipe = int(os.environ["PAM_ORTHOSIS_HEARTBEAT"])
while True:
    os.write(pipe, b"running 5000000\\n")
    time.sleep(0.05)
"""
STOPPED = "import os, signal, time; os.kill(os.getpid(), signal.SIGSTOP); time.sleep(60)"
STUCK = """
import os
from pam_orthosis.nodes.process import Heartbeat
Heartbeat().ends_within(0.2)
os.read(os.pipe()[0], 1)
"""
MUTE = "import time; time.sleep(60)"
CRASHING = "import sys; sys.exit('pam-orthosis: error: no air')"


def run(tmp_path, **programs):
    commands = {name: [sys.executable, "-c", text] for name, text in programs.items()}
    supervise(commands, dict(os.environ), tmp_path, lambda _: None)


def test_a_process_that_never_beats_is_named_once_the_graph_steps(tmp_path):
    with pytest.raises(RunFailed, match="node mute did not answer"):
        run(tmp_path, stepping=STEPPING, mute=MUTE)


@pytest.fixture
def idleness(monkeypatch):
    """Return a function: seconds, what a process does -> its idleness; the clock is the test's own."""
    clock = [100.0]
    monkeypatch.setattr(processes.time, "monotonic", lambda: clock[0])

    def lasting(seconds, turns):
        told = processes.Idleness(0, of=turns)
        for _ in range(round(seconds / 0.1) + 1):
            clock[0] += 0.1 + 1e-9
            told.look()
        return told

    return lasting


def working(state, share):
    """Return what a process of one thread does: the scheduler's letter, its share of the processor."""
    return lambda _: [processes.Turn(state, share * time.monotonic())]


@pytest.mark.parametrize(
    ("state", "share", "seconds", "silent"),
    [("R", 0.05, 10.0, False), ("R", 1.0, 2.0, True), ("S", 0.0, 2.0, True), ("D", 0.0, 10.0, False),
     ("R", 0.01, 99.0, True)],
    ids=["waits for its turn", "spins", "sleeps", "waits for the disk", "waits for ever"],
)  # fmt: skip
def test_time_in_which_a_process_waits_for_its_turn_is_not_its_own(idleness, state, share, seconds, silent):
    assert idleness(seconds, working(state, share)).silent(processes.SILENCE_SECONDS) is silent


LOCKED = """
import os, threading
def spin():
    pid = os.getpid()
    while open(f"/proc/{pid}/task/{pid}/stat").read().rpartition(")")[2].split()[0] != "S": pass
    print("the main thread sleeps", flush=True)
    while True: pass
threading.Thread(target=spin, daemon=True).start()
threading.Event().wait()
"""


def test_a_process_that_waits_for_its_own_thread_which_wants_the_processor_is_not_asleep():
    """A thread of the middleware may hold a lock while it waits for its turn."""
    command = [sys.executable, "-c", LOCKED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as locked:
        try:
            assert locked.stdout.readline()  # nothing if it has ended
            main, *threads = processes.turns_of_process(locked.pid)
        finally:
            locked.kill()
    assert not main.waits
    assert any(one.waits for one in threads)


@pytest.mark.parametrize(("states", "asleep"), [("SS", True), ("SR", False), ("RS", False), ("SD", False)])
def test_a_process_is_asleep_if_none_of_its_threads_wants_the_processor(
    monkeypatch, idleness, states, asleep
):
    monkeypatch.setattr(processes, "_listed", lambda _: [str(number) for number in range(len(states))])
    monkeypatch.setattr(
        processes, "_turn", lambda entry, _: processes.Turn(states[int(entry.rpartition("/")[2])])
    )
    told = idleness(2.0, processes.turns_of_process)
    assert told.silent(processes.SILENCE_SECONDS) is asleep


@pytest.mark.parametrize(
    ("state", "share", "rests"), [("S", 0.001, True), ("S", 0.1, False), ("R", 0.0, False)]
)
def test_a_process_that_works_now_and_then_does_not_rest(idleness, state, share, rests):
    assert (idleness(6.0, working(state, share)).resting > supervisor.IDLE_START_SECONDS) is rests


def test_a_process_that_hangs_before_its_first_beat_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "IDLE_START_SECONDS", 1.0)
    with pytest.raises(RunFailed, match="node mute hung while it was started"):
        run(tmp_path, mute=MUTE)


def test_a_process_whose_compiler_works_at_its_start_does_not_hang(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "IDLE_START_SECONDS", 0.5)
    monkeypatch.setattr(supervisor, "START_SECONDS", 1.0)
    spinning = f"import subprocess; subprocess.run([{sys.executable!r}, '-c', 'while True: pass'])"
    with pytest.raises(RunFailed, match="not ready after 1 s: waiting"):
        run(tmp_path, waiting=spinning)


WAITING_FOR_PEERS = """
import os, time
pipe = int(os.environ["PAM_ORTHOSIS_HEARTBEAT"])
for beat in range(400):
    os.write(pipe, b"starting %d\\n" % max(5, 20 - beat // 10))
    time.sleep(0.01)
"""


def test_a_start_that_comes_no_nearer_fails_after_so_many_beats(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "START_SECONDS", 2.0)  # 20 beats; before it waits 10 for each peer
    with pytest.raises(RunFailed, match="not ready after 2 s: waiting"):
        run(tmp_path, waiting=WAITING_FOR_PEERS)


def test_who_waits_for_one_that_still_loads_is_not_late(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "START_SECONDS", 2.0)
    loading = "import time; begun = time.process_time()\nwhile time.process_time() < begun + 1.5: pass\n1 / 0"
    with pytest.raises(RunFailed, match="node loading ended with 1: ZeroDivisionError"):
        run(tmp_path, waiting=WAITING_FOR_PEERS.replace("400", "100000"), loading=loading)


def test_a_process_that_works_at_its_start_is_not_taken_for_one_that_hangs(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "IDLE_START_SECONDS", 0.5)
    monkeypatch.setattr(supervisor, "START_SECONDS", 3.0)
    with pytest.raises(RunFailed, match="not ready after 3 s: slow"):
        run(tmp_path, slow="while True: pass")


LINGERING = """
import os, signal
os.write(int(os.environ["PAM_ORTHOSIS_HEARTBEAT"]), b"ended\\n")
while True:
    signal.pause()
"""


@pytest.fixture
def children(monkeypatch):
    """Return those that a supervisor has started, as it knows them in the end."""
    known = []

    class Known(supervisor.Child):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            known.append(self)

    monkeypatch.setattr(supervisor, "Child", Known)
    return known


def test_a_node_whose_run_is_over_and_that_does_not_go_is_let_go(tmp_path, monkeypatch, children):
    monkeypatch.setattr(supervisor, "STOP_GRACE_SECONDS", 0.5)
    run(tmp_path, plant_simulator=LINGERING)
    assert [(one.let_go, one.process.returncode) for one in children] == [(True, -signal.SIGKILL)]


CRASHING_AT_THE_END = """
import os, signal
os.write(int(os.environ["PAM_ORTHOSIS_HEARTBEAT"]), b"%s\\n")
os.kill(os.getpid(), signal.SIGSEGV)
"""


def test_a_node_that_crashes_when_its_run_is_over_spoils_nothing_and_is_named(tmp_path, capfd):
    run(tmp_path, plant_simulator=CRASHING_AT_THE_END % "ended")
    assert "node plant_simulator was killed by SIGSEGV when its run was over" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("name", "status"),
    [("plant_simulator", "running 5"), ("plant_simulator", "leaving"), ("bag_recorder", "ended")],
)
def test_a_node_that_crashes_before_that_or_writes_a_bag_fails_the_run(tmp_path, name, status):
    with pytest.raises(RunFailed, match=f"node {name} was killed by SIGSEGV"):
        run(tmp_path, **{name: CRASHING_AT_THE_END % status})


@pytest.mark.parametrize("name", ["bag_recorder", "composed", "bag_player"])
def test_who_writes_a_bag_is_not_let_go_before_it_is_closed(tmp_path, monkeypatch, name):
    monkeypatch.setattr(supervisor, "STOP_GRACE_SECONDS", 0.5)
    with pytest.raises(RunFailed, match=f"node {name} did not answer"):
        run(tmp_path, **{name: LINGERING})


@pytest.mark.parametrize("name", ["bag_recorder", "bag_player"])
def test_who_has_closed_his_bag_and_does_not_go_is_let_go(tmp_path, monkeypatch, children, name):
    monkeypatch.setattr(supervisor, "STOP_GRACE_SECONDS", 0.5)
    run(tmp_path, **{name: LINGERING.replace("ended", "closed")})
    assert [(one.let_go, one.process.returncode) for one in children] == [(True, -signal.SIGKILL)]


def test_time_in_which_the_machine_stood_still_is_nobodys_silence(tmp_path):
    child = supervisor.Child("node", [sys.executable, "-c", MUTE], dict(os.environ), tmp_path / "log")
    child.status, child._idleness._looked = "running 0", time.monotonic() - 30.0
    child.listen()
    assert not child.silent()
    child._idleness.asleep = 30.0
    assert child.silent()
    child.process.kill()
    child.process.wait()
    child.release()


def test_a_crash_is_told_in_the_words_of_the_process(tmp_path):
    with pytest.raises(RunFailed, match="node crashing ended with 1: no air"):
        run(tmp_path, stepping=STEPPING, crashing=CRASHING)


class Polled:
    """A process that ends with a status between two looks at it."""

    def __init__(self, *codes):
        self._codes = list(codes)

    def poll(self):
        return self._codes.pop(0) if len(self._codes) > 1 else self._codes[0]


@pytest.fixture
def polled(tmp_path, monkeypatch):
    """Return a function: exit status at each look -> child whose process has in truth ended."""
    monkeypatch.setattr(supervisor.Child, "stopped", lambda child: False)
    made = []

    def make(*codes):
        child = supervisor.Child("node", [sys.executable, "-c", "pass"], dict(os.environ), tmp_path / "log")
        child.process.wait()
        child.process = Polled(*codes)
        made.append(child)
        return child

    yield make
    for child in made:
        child.release()


def test_a_process_that_fails_just_after_it_was_judged_fails_the_run(polled):
    child = polled(None, None, 3)  # loop's condition, judgement, loop's condition
    child.status = "running 5000000"
    with pytest.raises(RunFailed, match="node node ended with 3"):
        supervisor._watch([child], lambda _: None)


def test_a_heartbeat_that_came_after_the_last_look_counts(polled, monkeypatch):
    child = polled(0)
    child.status = "running 5000000"
    monkeypatch.setattr(child, "listen", lambda: setattr(child, "status", "ended"))
    supervisor._judge(child)


def test_a_process_that_is_stopped_before_its_first_beat_is_named_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "START_SECONDS", 1e9)
    with pytest.raises(RunFailed, match=r"node stopped was stopped \(SIGSTOP\)"):
        run(tmp_path, stopped=STOPPED, mute=MUTE)


def test_a_process_that_ends_just_while_it_is_looked_at_is_not_stopped(tmp_path, monkeypatch):
    child = supervisor.Child("node", [sys.executable, "-c", "pass"], dict(os.environ), tmp_path / "log")
    os.waitid(os.P_PID, child.process.pid, os.WEXITED | os.WNOWAIT)
    with monkeypatch.context() as just_before:
        just_before.setattr(child.process, "poll", lambda: None)
        assert not child.stopped()
    assert child.process.wait() == 0
    assert not child.stopped()
    child.release()


def test_the_recorder_is_asked_to_end_when_all_others_have_ended(tmp_path):
    marks = tmp_path / "marks"
    marking = f"""
import signal, sys, time
def end(number, frame):
    with open({str(marks)!r}, "a") as file: file.write(sys.argv[1])
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
open({str(marks)!r} + sys.argv[1], "w")
while True: time.sleep(1)
"""
    crashing = f"""
import os, sys, time
while not all(os.path.exists({str(marks)!r} + name) for name in "rn"): time.sleep(0.01)
sys.exit("no air")
"""
    commands = {
        "bag_recorder": [sys.executable, "-c", marking, "r"],
        "node": [sys.executable, "-c", marking, "n"],
        "crashing": [sys.executable, "-c", crashing],
    }
    with pytest.raises(RunFailed, match="node crashing ended"):
        supervise(commands, dict(os.environ), tmp_path, lambda _: None)
    assert marks.read_text() == "nr"


def test_a_process_that_is_stuck_in_a_call_ends_itself_and_its_log_tells_where(tmp_path):
    log = tmp_path / "log"
    child = supervisor.Child("stuck", [sys.executable, "-c", STUCK], dict(os.environ), log)
    assert child.process.wait() == 1
    assert "Timeout" in log.read_text()
    child.release()


def test_without_a_supervisor_nothing_ends_a_process(monkeypatch):
    monkeypatch.delenv(supervisor.HEARTBEAT_VARIABLE, raising=False)
    armed = []
    monkeypatch.setattr(process.faulthandler, "dump_traceback_later", lambda *a, **k: armed.append(a))
    process.Heartbeat().ends_within(1.0)
    assert not armed


class Listening:
    """A node that hears something in some turns, and the executor of it."""

    configured = True

    def __init__(self, *turns):
        self.heard, self.turns = turns, 0

    def abandon(self):
        return True

    def hears(self):
        return self.turns in self.heard

    def spin_until_future_complete(self, _future, timeout_sec):
        self.turns += 1


def test_a_recorder_listens_until_nothing_comes_any_more():
    node = Listening(1, 2, 3)
    process._abandon([node], node, 0.1)
    assert node.turns == 5


def test_a_turn_in_which_the_machine_stood_still_is_not_the_end_of_the_last_words():
    node = Listening(1, 3)
    process._abandon([node], node, 0.1)
    assert node.turns == 5


def test_a_process_with_other_nodes_says_its_last_words_and_goes():
    node = Listening(1, 2, 3)
    process._abandon([node, Listening()], node, 0.1)
    assert node.turns == 2


def test_what_a_process_has_started_ends_with_the_run(tmp_path):
    starts = "import subprocess; print(subprocess.Popen(['sleep', '60']).pid, flush=True)"
    with pytest.raises(RunFailed):
        supervise({"node": [sys.executable, "-c", starts]}, dict(os.environ), tmp_path, lambda _: None)
    helper = Path("/proc", (tmp_path / "node.log").read_text().strip(), "stat")
    assert not helper.exists() or helper.read_text().rpartition(")")[2].split()[0] in "ZX"


def test_a_helper_that_has_ended_and_was_not_asked_for_its_status_is_not_waited_for(tmp_path, monkeypatch):
    child = supervisor.Child("node", [sys.executable, "-c", ""], dict(os.environ), tmp_path / "log")
    os.waitid(os.P_PID, child.process.pid, os.WEXITED | os.WNOWAIT)
    os.killpg(child.process.pid, 0)  # the system still knows its group
    with monkeypatch.context() as patch:
        patch.setattr(supervisor.time, "sleep", lambda _: pytest.fail("it is waited for"))
        child.end_helpers(60.0)
    child.process.wait()
    child.release()
