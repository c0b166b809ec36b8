# SPDX-License-Identifier: Apache-2.0
"""A bag of version 0.1, of a run by a plan, reads, passes and replays as one of today."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from pam_orthosis.bag.read import raw_messages, read_bag
from pam_orthosis.bag.topics import Topics
from pam_orthosis.cli.main import main
from pam_orthosis.model.machines import KNEE

EARLIER = Path(__file__).with_name("earlier")
STEPS = 200


def last_numbers(topic, count=1):
    """Return the last float64 numbers of each message of a topic as they were recorded."""
    with open(EARLIER / "earlier_0.mcap", "rb") as stream:
        data = [message.data for _, _, message in make_reader(stream).iter_messages(topics=[topic])]
    return np.array([struct.unpack(f"<{count}d", one[-8 * count :]) for one in data])


def test_every_signal_is_there():
    known = Topics(KNEE).signals
    bag = read_bag(EARLIER, list(known))
    assert {name: len(bag[name].value) for name in known} == dict.fromkeys(known, STEPS)


@pytest.mark.parametrize("name", ["extensor", "flexor"])
def test_voltages_and_gas_are_those_that_were_recorded(name):
    signals = [f"{name}_voltage", f"truth_{name}_pressure"]
    bag = read_bag(EARLIER, signals)
    volts, truth = last_numbers(f"/{name}/valve_voltage"), last_numbers("/truth", 2)
    assert np.abs(bag[signals[0]].value - volts[:, 0]).max() < 2e-15  # what a spool's position keeps of volts
    gas = truth[:, ["extensor", "flexor"].index(name)]
    np.testing.assert_array_equal(bag[signals[1]].value, gas)


def test_the_motion_of_the_plan_and_its_pressure_are_topics_of_their_own():
    with AnyReader([EARLIER]) as reader:
        topic = [one for one in reader.connections if one.topic == "/reference"]
        points = [reader.deserialize(data, one.msgtype).points for one, _, data in reader.messages(topic)]
    asked = raw_messages(EARLIER, ["reference_pressure"])["reference_pressure"].values()
    pressures = [struct.unpack_from("<d", data, len(data) - 16)[0] for data in asked]  # before the variance
    assert pressures == [wanted.effort[0] for wanted, _ in points]
    followed = read_bag(EARLIER, ["followed_angle"])["followed_angle"].value
    assert followed.tolist() == [planned.positions[0] for _, planned in points]


def test_it_passes(capsys):
    assert main(["check", str(EARLIER), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == STEPS


def test_it_is_replayed_but_for_rounding(capsys):
    pytest.importorskip("rclpy")
    assert main(["replay", str(EARLIER), "--json"]) == 0
    topics = {one["topic"]: one for one in json.loads(capsys.readouterr().out)["legs"][""]}
    assert all(one["equal"] + one["rounded"] == STEPS for one in topics.values())
    for name in ("extensor/valve_command", "flexor/mass_flow", "truth/flexor/pressure"):
        assert topics[name]["same"], name
