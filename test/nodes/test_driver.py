# SPDX-License-Identifier: Apache-2.0
"""A driver keeps the contract of docs/howto/driver.md, whatever its device and its peers do."""

import math
import sys

import pytest

rclpy = pytest.importorskip("rclpy")
from own_domain import own_domain  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from pam_orthosis.nodes import driver, messages  # noqa: E402
from pam_orthosis.nodes.driver import State  # noqa: E402

VENT, OPEN = (-1.0, -1.0), (0.4, 0.3)
PERIOD_NS = 5_000_000


class Scripted(driver.Driver):
    """A driver of a device that is a list of what was done to it; time passes by `period` alone."""

    def __init__(self):
        self.now_ns, self.answers, self.homes, self.slow = 0, True, 0, 0.0
        self.valves, self.published, self.calls = [0.0, 0.0], [], []
        self.sample = 0.5, 2e5, 3e5
        super().__init__("scripted")
        self._joint.publish = self.published.append

    elapsed_ns = property(lambda self: self.now_ns)

    def connect(self):
        self._called("connect")

    def home(self):
        self.homes -= 1
        return self.homes < 0

    def read(self):
        self._called("read")
        driver.time.now += self.slow
        return self.sample

    def write(self, line, spool):
        self._called("write")
        self.valves[line] = spool

    def vent(self):
        self._called("vent")
        self.valves = list(VENT)

    def disconnect(self):
        self._called("disconnect")

    def _called(self, what):
        self.calls.append(what)
        if not self.answers:
            raise ConnectionError("no answer")

    def period(self, count=1):
        self.now_ns += count * PERIOD_NS
        driver.time.now += count * PERIOD_NS * 1e-9
        self._tick()

    def told(self, *spools):
        for line, spool in enumerate(spools):
            if spool is not None:
                self._on_command(line, messages.joint_state(0, ["valve"], position=[spool]))

    def asked(self, service):
        return getattr(self, f"_on_{service}")(Trigger.Request(), Trigger.Response())


class Clock:
    """Stands for the module `time`."""

    now = 0.0

    def monotonic(self):
        return self.now


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Return a function that makes a driver whose device homes in so many periods."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.setattr(driver, "time", Clock())
    made = []

    def make(homes=0):
        rclpy.init(domain_id=own_domain())
        made.append(Scripted())
        made[-1].homes = homes
        return made[-1]

    yield make
    for one in made:
        one.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def ready(make):
    """Return a driver that is ready."""
    made = make()
    made.period()
    made.period()
    assert made.state is State.READY
    return made


def test_it_is_ready_when_its_device_has_homed_and_follows_no_command_before(make):
    scripted = make(homes=2)
    states = []
    for _ in range(4):
        scripted.told(*OPEN)
        states.append(scripted.state)
        scripted.period()
        assert tuple(scripted.valves) in (VENT, (0.0, 0.0))
    assert states == [State.DISCONNECTED, State.HOMING, State.HOMING, State.HOMING]
    assert scripted.state is State.READY
    scripted.told(*OPEN)
    assert tuple(scripted.valves) == OPEN


def test_each_period_has_a_sample_on_the_grid_and_what_is_overdue_is_skipped(ready):
    ready.published.clear()
    ready.period()
    ready.period(3)
    stamps = [messages.nanoseconds(one.header.stamp) - ready._first_ns for one in ready.published]
    assert stamps == [3 * PERIOD_NS, 6 * PERIOD_NS]
    assert ready.published[0].position[0] == 0.5
    assert ready._counts["skipped_samples"] == 2


@pytest.mark.parametrize("sample", [(0.3,), None, (0.5, 2e5, "full")], ids=str)
def test_a_device_whose_sample_is_none_is_vented_and_taken_for_lost(ready, sample):
    ready.told(*OPEN)
    ready.published.clear()
    ready.sample = sample
    ready.period()
    assert (ready.state, tuple(ready.valves), ready.published) == (State.DISCONNECTED, VENT, [])
    assert "read() returned" in ready.reason


@pytest.mark.parametrize("position", [(), (math.nan,), (math.inf,)], ids=str)
def test_what_is_no_command_is_passed_over(ready, position):
    ready._on_command(0, messages.joint_state(0, ["valve"], position=position))
    assert ready.valves == [0.0, 0.0]


def test_a_command_beyond_the_valves_range_is_limited(ready):
    ready.told(1e9, -7.0)
    assert ready.valves == [1.0, -1.0]


def test_a_muscle_without_commands_vents_both_until_both_have_some(ready):
    ready.told(*OPEN)
    for _ in range(driver.SILENCE_PERIODS):
        ready.period()
        ready.told(OPEN[0])
        assert tuple(ready.valves) == OPEN
    ready.period()
    ready.told(OPEN[0])
    assert tuple(ready.valves) == VENT
    assert ready._counts["silent_periods"] == 1
    ready.told(None, OPEN[1])
    assert tuple(ready.valves) == OPEN


def _lose(scripted):
    scripted.told(*OPEN)
    scripted.answers = False
    scripted.period()
    assert scripted.state is State.DISCONNECTED


def test_a_device_that_is_lost_is_sought_again_and_no_sample_is_made_up(ready):
    _lose(ready)
    ready.published.clear()
    ready.calls.clear()
    for _ in range(110):  # 0.55 s
        ready.told(*OPEN)
        ready.period()
    assert ready.published == []
    assert ready.calls == ["connect"] * 3  # one each 0.2 s
    assert ready._counts["lost_connections"] == 1


def test_a_device_that_has_come_back_stays_vented_until_reset(ready):
    _lose(ready)
    ready.answers = True
    for _ in range(50):
        ready.period()
        ready.told(*OPEN)
    assert ready.state is State.FAULT
    assert "no answer" in ready.reason
    assert tuple(ready.valves) == VENT
    assert ready.published  # its peers see where the leg is
    assert ready.asked("reset").success
    ready.told(*OPEN)
    assert ready.state is State.READY
    assert tuple(ready.valves) == OPEN


def test_a_sample_that_takes_too_long_is_a_loss(ready):
    ready.slow = 0.2
    ready.published.clear()
    ready.period()
    assert ready.published == []
    assert ready.state is State.DISCONNECTED
    assert "longer than 0.1 s" in ready.reason
    assert tuple(ready.valves) == VENT


def test_an_emergency_stop_vents_until_reset(ready):
    ready.told(*OPEN)
    assert ready.asked("stop").success
    ready.told(*OPEN)
    ready.period()
    assert (ready.state, tuple(ready.valves)) == (State.FAULT, VENT)
    assert ready.asked("reset").success
    assert not ready.asked("reset").success


def test_a_reset_while_it_homes_leads_back_to_that_and_the_valves_follow_only_then(make):
    scripted = make(homes=3)
    scripted.period()
    scripted.period()
    assert scripted.state is State.HOMING
    scripted.asked("stop")
    assert "homes before" in scripted.asked("reset").message
    scripted.told(*OPEN)
    scripted.period()
    assert (scripted.state, tuple(scripted.valves)) == (State.HOMING, VENT)
    scripted.period()
    scripted.period()
    scripted.told(*OPEN)
    assert (scripted.state, tuple(scripted.valves)) == (State.READY, OPEN)


def test_a_reset_while_it_homes_after_a_loss_does_not_stand_for_the_look_at_the_device(ready):
    _lose(ready)
    ready.answers, ready.homes = True, 2
    while ready.state is State.DISCONNECTED:
        ready.period()
    ready.asked("stop")
    assert ready.asked("reset").success
    assert ready.state is State.HOMING
    for _ in range(3):
        ready.period()
    assert (ready.state, ready.reason) == (State.FAULT, "connected again after a loss: no answer")
    assert ready.asked("reset").success
    assert ready.state is State.READY


def test_a_device_that_finds_a_fault_as_it_homes_is_not_ready(make):
    scripted = make()
    scripted.home = lambda: scripted.fault("no reference switch") or True
    scripted.period()
    scripted.period()
    assert (scripted.state, scripted.reason) == (State.FAULT, "no reference switch")


def test_a_stop_by_a_node_of_the_graph_vents_until_it_is_released(ready):
    def tell(stamp_ns, level):
        ready._on_stop_state(messages.diagnostics(stamp_ns, "safety_monitor: emergency stop", level, "", {}))
        ready.period()
        ready.told(*OPEN)

    tell(2, driver.DiagnosticStatus.ERROR)
    assert ready.valves == list(VENT)
    tell(1, driver.DiagnosticStatus.OK)  # an older word that comes later
    assert ready.valves == list(VENT)
    tell(3, driver.DiagnosticStatus.OK)
    assert ready.valves == list(OPEN)


def test_health_is_an_error_while_the_valves_do_not_follow_for_good(ready):
    reports = []
    ready._health.publish = lambda message: reports.append(message.status[0])
    ready._report()
    _lose(ready)
    ready._report()
    assert [one.level for one in reports] == [b"\x00", b"\x02"]
    assert reports[1].message == "disconnected: no answer"
    assert {one.key: one.value for one in reports[1].values}["lost_connections"] == "1"


def test_it_leaves_the_device_vented_whatever_ended_it(tmp_path, monkeypatch):
    made = []

    class Failing:
        def add_node(self, node):
            made.append(node)
            node.told(*OPEN)

        def spin_once(self, timeout_sec):
            raise ValueError("a callback failed")

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain()))
    monkeypatch.setattr(driver.process, "EventsExecutor", Failing)
    monkeypatch.setattr(sys, "argv", ["scripted"])
    monkeypatch.setattr(driver.process, "caught_signals", list)
    with pytest.raises(ValueError, match="a callback failed"):
        driver.run(Scripted)
    assert tuple(made[0].valves) == VENT
    assert made[0].calls[-2:] == ["vent", "disconnect"]
