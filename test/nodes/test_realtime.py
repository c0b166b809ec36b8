# SPDX-License-Identifier: Apache-2.0
"""Real time: what depends on no machine's speed."""

import json
import subprocess
import sys

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import Topics, resolve
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import config_folder, load

pytest.importorskip("rclpy")
from pam_orthosis.nodes.launch import free_domain
from pam_orthosis.nodes.pace import MAX_PERIODS_AT_ONCE

TABLE, CLOSED = Topics(KNEE), 0.0

# a period that a busy machine keeps too, most of the time
SLOW = ["--param", "scenario.control_period=0.04", "--param", "scenario.trajectory=hold"]
PERIOD_NS = 40_000_000
GENTLE = ["--param", "control.position.c1=5", "--param", "control.position.c2=5"]
GENTLE += ["--param", "control.observer.pole=15", "--param", "control.pressure.gain=8"]


class FakePlant:
    """What `RealTime` needs of its node, and a clock that the test sets."""

    period_ns, commands = 5_000_000, {topic: ("", topic) for topic in TABLE.commands}

    def __init__(self):
        self.parameters = load()
        self.ended = self.abandoned = False
        self.active = True
        self.now = 1_000_000_000
        self.sample_cost = self.period_cost = 0
        self.receivers, self.samples, self.applied = {}, [], []
        self.spools, self.came = [CLOSED] * 2, []

    def listen_to_numbers(self, topic, fields, callback, leg):
        self.receivers[topic] = callback

    def create_timer(self, period_s, callback):
        self.tick = callback

    def now_ns(self):
        return self.now

    def publish_sample(self, stamp_ns):
        self.samples.append(stamp_ns)
        self.now += self.sample_cost

    def step_done(self, stamp_ns):
        pass

    def take(self, line, spool, at_ns):
        self.spools[line] = spool
        self.came.append((line, spool, at_ns))

    def live_on(self):
        self.applied.append(tuple(self.spools))
        self.now += self.period_cost

    def answer(self, spool, stamp_ns):
        for receive in self.receivers.values():
            receive(stamp_ns, (spool,))


@pytest.fixture
def plant():
    from pam_orthosis.nodes.pace import RealTime

    plant = FakePlant()
    plant.pace = RealTime(plant)
    plant.pace.begin()
    plant.tick()
    return plant


def _counted(plant):
    health = plant.pace.health()
    return health["late_answers"], health["skipped_samples"]


def test_valves_without_commands_vent(plant):
    from pam_orthosis.nodes.pace import SILENCE_SAMPLES

    plant.answer(0.2, plant.samples[0])
    for _ in range(SILENCE_SAMPLES + 3):
        plant.now += plant.period_ns
        plant.tick()
    assert plant.applied[0] != (VENT, VENT)
    assert plant.applied[-2:] == [(VENT, VENT)] * 2
    plant.answer(0.2, plant.samples[-1])
    plant.now += plant.period_ns
    plant.tick()
    assert plant.applied[-1] != (VENT, VENT)


def test_valves_vent_when_one_of_them_was_never_told_anything(plant):
    from pam_orthosis.nodes.pace import SILENCE_SAMPLES

    for _ in range(2 * SILENCE_SAMPLES):  # nobody is there yet
        plant.now += plant.period_ns
        plant.tick()
    for _ in range(SILENCE_SAMPLES + 2):
        plant.receivers[TABLE.commands[0]](plant.samples[-1], (0.2,))
        plant.now += plant.period_ns
        plant.tick()
    assert (VENT, VENT) not in plant.applied[: 3 * SILENCE_SAMPLES]
    assert plant.applied[-1] == (VENT, VENT)
    assert plant.pace.health()["vented_without_commands"] > 0


def test_no_stamp_is_later_than_its_sample(plant):
    """Else answers would seem to leave before what they answer: a late tick makes no later one early."""
    taken = [1_000_000_000]
    for late in (1_400_000, 0, 200_000):
        plant.now = 1_000_000_000 + len(taken) * plant.period_ns + late
        taken.append(plant.now)
        plant.tick()
    assert len(plant.samples) == 4
    assert all(stamp <= instant for stamp, instant in zip(plant.samples, taken, strict=True))


def test_a_command_counts_from_the_instant_at_which_it_came(plant):
    """Not from its sample, whose answer it is: the time between them is lost to a real valve too."""
    plant.now += 3_000_000
    plant.answer(0.2, plant.samples[0])
    assert plant.came == [(0, 0.2, 3_000_000), (1, 0.2, 3_000_000)]
    plant.now += 2_000_000
    plant.tick()
    assert plant.applied == [(0.2, 0.2)]
    assert _counted(plant) == (0, 0)


def test_without_an_answer_the_valves_stay_and_it_is_counted(plant):
    plant.now += plant.period_ns
    plant.tick()
    assert plant.applied == [(CLOSED, CLOSED)]
    assert _counted(plant) == (1, 0)


def test_jitter_costs_no_sample(plant):
    first = plant.samples[0]
    for jitter in (-2_000_000, 1_500_000, 0):
        plant.now += plant.period_ns
        late, plant.now = plant.now, plant.now + jitter
        plant.tick()
        plant.now = late
    assert plant.samples == [first + k * plant.period_ns for k in range(4)]
    assert plant.pace.health()["skipped_samples"] == 0


def test_samples_that_were_missed_in_a_pause_are_skipped_but_the_hardware_lives_on(plant):
    first = plant.samples[0]
    plant.now += 10 * plant.period_ns
    plant.tick()
    assert plant.samples == [first, first + 10 * plant.period_ns]
    assert len(plant.applied) == 10
    assert _counted(plant) == (1, 9)


@pytest.mark.parametrize("cost_periods", [1.5, 3.0, 40.0])
def test_on_a_machine_that_is_too_slow_no_callback_grows(plant, cost_periods):
    """Making up for samples that are overdue took longer each time, until nothing else had its turn."""
    plant.sample_cost = round(cost_periods * plant.period_ns)
    costs = []
    for _ in range(50):
        begun = plant.now
        plant.tick()
        costs.append(plant.now - begun)
        plant.now = max(plant.now, begun + plant.period_ns)
    assert max(costs) == plant.sample_cost
    assert plant.pace.health()["skipped_samples"] > 10
    assert len(plant.applied) * plant.period_ns == plant.samples[-1] - plant.samples[0]


def test_hardware_that_is_slower_than_time_gives_no_sample_but_holds_up_nothing(plant):
    plant.period_cost = 2 * plant.period_ns
    plant.now += plant.period_ns
    costs, samples = [], []
    for _ in range(20):
        begun = plant.now
        plant.tick()
        costs.append(plant.now - begun)
        samples.append(len(plant.samples))
    assert max(costs) == costs[-1] == MAX_PERIODS_AT_ONCE * plant.period_cost
    assert samples[-1] == samples[-10]


def test_a_node_counts_samples_that_it_finished_too_late():
    from pam_orthosis.nodes.graph import Ages

    ages = Ages(5_000_000)
    for age in (1_000_000, 2_000_000, 6_000_000):
        ages.add(age)
    assert ages.missed == 1
    assert ages.figures() == {"latency_mean_ms": 3.0, "latency_max_ms": 6.0}
    assert ages.figures() == {}


def _stamps(bag):
    return read_bag(bag, ["angle"])["angle"].stamp_ns


@pytest.mark.parametrize("layout", [[], ["--composed"]])
def test_a_run_by_the_wall_clock_tells_its_timing(run_graph, layout):
    done, bag = run_graph("--realtime", "--duration", "2", *SLOW, *GENTLE, *layout, "--json")
    assert done.returncode in (0, 1), done.stderr  # tracking depends on the machine's load
    timing = json.loads(done.stdout)["timing"]
    assert timing["deadline_ms"] == 40.0
    assert 0.0 < timing["latency_median_ms"] <= timing["latency_max_ms"]
    assert timing["periods"] - timing["skipped_samples"] == len(_stamps(bag))
    assert not np.any(np.diff(_stamps(bag)) % PERIOD_NS)
    with AnyReader([bag]) as reader:
        there = {connection.topic for connection in reader.connections}
    assert there >= {resolve(topic.name) for topic in TABLE.of_run(realtime=True).values() if topic.recorded}


def test_more_than_any_machine_can_do_costs_samples_not_the_run(run_graph):
    """2 kHz through seven processes: every queue is always full, and still every node answers."""
    done, bag = run_graph(
        "--realtime", "--duration", "3", "--param", "scenario.control_period=0.0005", "--json"
    )
    assert done.returncode in (0, 1), done.stderr
    timing = json.loads(done.stdout)["timing"]
    assert timing["periods"] - timing["skipped_samples"] == len(_stamps(bag))
    assert _who_reports(bag) == {f"{node}: loop" for node in TABLE.nodes}


def _who_reports(bag):
    with AnyReader([bag]) as reader:
        asked = [one for one in reader.connections if one.topic == "/diagnostics"]
        reports = [reader.deserialize(data, one.msgtype) for one, _, data in reader.messages(asked)]
    return {status.name for report in reports for status in report.status}


@pytest.mark.parametrize("every", [1, 2])
def test_a_driver_stands_in_for_the_plant(run_graph, monkeypatch, every):
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "loopback.xml"))
    with free_domain() as domain:  # nodes of earlier tests may linger in this process's own
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        driver = subprocess.Popen([sys.executable, "-m", "pam_orthosis.nodes.dummy_driver"])
        try:
            rates = ["--param", f"control.position.every={every}"]
            done, bag = run_graph("--realtime", "--no-plant", "--duration", "2", "--json", *rates)
        finally:
            driver.terminate()
    assert driver.wait(30) == 0
    assert done.returncode in (0, 1), done.stderr
    timing = json.loads(done.stdout)["timing"]
    assert timing["periods"] > 300
    with AnyReader([bag]) as reader:
        there = {connection.topic for connection in reader.connections}
    assert "/truth" not in there
    assert "/extensor/valve_command" in there
    quick, slow = (read_bag(bag, [name])[name].stamp_ns for name in ("extensor_mass_flow", "estimate_angle"))
    period_ns = round(load().scenario.control_period * 1e9)
    assert len(slow) > 10
    assert not np.any(np.diff(quick) % period_ns)
    assert not np.any(np.diff(slow) % (every * period_ns))
    for stamp in quick[quick >= slow[0]]:  # the driver may have begun before the recorder
        assert np.any((slow <= stamp) & (slow > stamp - every * period_ns))


def test_hardware_is_not_for_lockstep(run_graph):
    done, _ = run_graph("--no-plant")
    assert done.returncode == 2
    assert "--realtime" in done.stderr
