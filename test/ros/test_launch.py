# SPDX-License-Identifier: Apache-2.0
"""Launch files name what there is; where `launch` is installed (it is not on PyPI), they start walks."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
from installed import LIMIT_S, ROOT, sourced

from pam_orthosis.cli.main import main
from pam_orthosis.control.legs import differences
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.launch import free_domain

sys.path.insert(0, str(ROOT / "docs"))
from generators import declared, nodes

FILES = sorted((ROOT / "launch").iterdir())
NEEDED = ("launch", "launch_ros", "launch_xml", "ros2launch")
WALKS = {
    "one_leg": (),
    "two_legs": (),
    "one_leg-realtime": ("realtime:=true",),
    "one_leg-safety": ("safety:=true",),
}


def _tree(name):
    return ElementTree.parse(ROOT / "launch" / name).getroot()


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_file_names_executables_arguments_and_files_that_there_are(file):
    tree = _tree(file.name)
    for node in tree.iter("node"):
        assert node.get("pkg") == "pam_orthosis"
        assert node.get("exec") in nodes.installed()
    for include in tree.iter("include"):
        included = _tree(include.get("file").removeprefix("$(dirname)/"))
        taken = {argument.get("name") for argument in included.findall("arg")}
        assert {argument.get("name") for argument in include.findall("arg")} <= taken


def test_every_parameter_is_one_of_the_nodes():
    pytest.importorskip("rclpy")
    for file in FILES:
        tree = _tree(file.name)
        for_all = [one.get("name") for one in tree.iter("set_parameter")]
        for module, name in [
            *(
                (node.get("exec"), one.get("name"))
                for node in tree.iter("node")
                for one in node.iter("param")
            ),
            *(("position_controller", name) for name in for_all),
        ]:
            if "." in name:
                assert load().nominal().row(name)
            else:
                assert name in {one.name for one in declared.declared(module)}


def test_two_legs_are_those_of_a_run():
    tree = _tree("two_legs.launch.xml")
    (legs,) = (one.get("value") for one in tree.iter("param") if one.get("name") == "legs")
    assert json.loads(legs) == differences(load())
    *_, right = tree.findall("group")
    given = {one.get("name"): json.loads(one.get("value")) for one in right if "." in one.get("name", "")}
    assert given == differences(load())["right"]


@pytest.mark.skipif(
    not all(map(find_spec, NEEDED)), reason="ros2 launch is not installed: it comes with ROS, not from PyPI"
)
@pytest.mark.parametrize("walk", WALKS)
def test_ros2_launch_walks(walk, install_space, tmp_path, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    command = [Path(sys.executable).with_name("ros2"), "launch", "pam_orthosis"]
    file, bag = f"{walk.partition('-')[0]}.launch.xml", tmp_path / "bag"
    command += [file, "duration:=1.0", f"directory:={bag}", *WALKS[walk]]
    with free_domain() as domain:
        said, _ = sourced(install_space, command, domain).communicate(timeout=LIMIT_S)
    assert "exit code" not in said
    assert (bag / "metadata.yaml").exists(), said
    if not WALKS[walk]:  # how well it walks by the wall clock is the machine's matter
        assert main(["check", str(bag)]) == 0
