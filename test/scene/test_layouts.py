# SPDX-License-Identifier: Apache-2.0
"""Each path in the layouts for Lichtblick, PlotJuggler and Rerun leads to a number in a recorded bag."""

import json
import re
import runpy
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.topics import JOINT, MOTION, Topics
from pam_orthosis.model.device import device_named

ROOT = Path(__file__).resolve().parents[2]
LICHTBLICK = json.loads((ROOT / "config" / "lichtblick.json").read_text())
OF_DEVICE = json.loads((ROOT / "config" / "lichtblick-device.json").read_text())
PANELS = LICHTBLICK["configById"]
PLOTTED, DEVICE_PLOTTED = (
    [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    for layout in (LICHTBLICK, OF_DEVICE)
)
RERUN = runpy.run_path(str(ROOT / "config" / "rerun_layout.py"))
CURVES = [curve.get("name") for curve in ElementTree.parse(ROOT / "config" / "plotjuggler.xml").iter("curve")]
DEVICE_CURVES = [
    curve.get("name") for curve in ElementTree.parse(ROOT / "config" / "plotjuggler-device.xml").iter("curve")
]
ENTITIES = [path for paths in RERUN["PLOTS"].values() for path in paths]
MODIFIERS = {"rad2deg", "deg2rad", "negative"}
JOINT_FIELDS = ("position", "velocity", "effort")


@pytest.fixture(scope="module")
def recorded():
    """Return the types by topic of the reference bag, and one message of each topic."""
    with AnyReader([ROOT / "bags" / "walk"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        types = {one.topic: one.msgtype for one in reader.connections}
        messages = {}
        for connection, _, data in reader.messages():
            messages.setdefault(connection.topic, reader.deserialize(data, connection.msgtype))
    return types, messages


def at_path(messages, path):
    """Return what a message path of Lichtblick leads to: /topic.field[index].field.@modifier."""
    topic, fields, modifier = re.fullmatch(r"((?:/\w+)+)((?:\.\w+|\[\d+\])*)(?:\.@(\w+))?", path).groups()
    assert modifier is None or modifier in MODIFIERS
    value = messages[topic]
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", fields):
        value = getattr(value, name) if name else value[int(index)]
    return value


def series(messages):
    """Return the names of the series that PlotJuggler makes: joints by name, the rest by field."""
    names = set()
    for topic, message in messages.items():
        if message.__msgtype__.endswith("JointState"):
            there = [field for field in JOINT_FIELDS if len(getattr(message, field))]
            names |= {f"{topic}/{joint}/{field}" for joint in message.name for field in there}
        else:
            names |= set(leaves(topic, message))
    return names


def leaves(name, value):
    if isinstance(value, float | int):
        yield name
    elif hasattr(value, "__dataclass_fields__"):
        for field in value.__dataclass_fields__:
            yield from leaves(f"{name}/{field}", getattr(value, field))
    elif not isinstance(value, str | bytes):
        for index, one in enumerate(value):
            yield from leaves(f"{name}[{index}]", one)


@pytest.mark.parametrize("path", PLOTTED)
def test_a_plotted_path_leads_to_a_number(recorded, path):
    assert isinstance(float(at_path(recorded[1], path)), float)


@pytest.mark.parametrize("curve", CURVES)
def test_a_curve_is_a_series_of_plotjuggler(recorded, curve):
    assert curve in series(recorded[1])


def test_each_curve_of_a_device_is_a_signal_of_one_of_its_machines():
    device, there, plotted = device_named(Path("device")), set(), set()
    for side, (name, machine) in product(device.sides, device.joints.items()):
        for one in Topics(machine).signals.values():
            field = f"points[0]/{one.field}[0]" if one.type == MOTION else one.field.replace(".", "/")
            words = f"/{side}/{name}", one.topic, one.joint if one.type == JOINT else "", field
            there.add("/".join(filter(None, words)))
            place = field.replace("/", ".") + "[0]" * (one.type == JOINT)
            plotted.add(f"/{side}/{name}/{one.topic}.{place}")
    assert len(DEVICE_CURVES) == 20
    assert set(DEVICE_CURVES) <= there
    assert len(DEVICE_PLOTTED) == 20
    assert {path.removesuffix(".@rad2deg") for path in DEVICE_PLOTTED} <= plotted


@pytest.mark.parametrize("entity", ENTITIES)
def test_an_entity_is_what_rerun_makes_of_a_topic(recorded, entity):
    """Each field of joint states below its topic, a pressure as its topic."""
    types, messages = recorded
    topic, _, field = entity.rpartition("/")
    if types.get(topic) == "sensor_msgs/msg/JointState":
        assert field in JOINT_FIELDS
        assert len(getattr(messages[topic], field)) == 1
    else:
        assert types[entity] == "sensor_msgs/msg/FluidPressure"


def test_the_leg_is_shown_by_topics_and_a_frame_that_are_there(recorded):
    types, messages = recorded
    panel = PANELS["3D!leg"]
    assert {topic: types[topic] for topic in panel["topics"]} == {
        "/robot_description": "std_msgs/msg/String",
        "/markers": "visualization_msgs/msg/MarkerArray",
    }
    frames = {one.header.frame_id for topic in ("/tf", "/tf_static") for one in messages[topic].transforms}
    assert panel["followTf"] in frames
    assert {layer["frameId"] for layer in panel["layers"].values()} <= frames
    assert types[PANELS["DiagnosticSummary!health"]["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"


@pytest.mark.parametrize("layout", [LICHTBLICK, OF_DEVICE], ids=["leg", "device"])
def test_every_panel_has_its_place(layout):
    def placed(node):
        return {node} if isinstance(node, str) else placed(node["first"]) | placed(node["second"])

    assert placed(layout["layout"]) == set(layout["configById"])
