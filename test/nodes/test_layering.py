# SPDX-License-Identifier: Apache-2.0
"""Who may import and know what."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pam_orthosis
from pam_orthosis.bag.topics import NODES, PLANT, PUBLISHED_DEPTH, RECORDER, TOPICS
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.nodes.layout import LAYOUT

PACKAGE = Path(pam_orthosis.__file__).parent
BLOCKED = ("rclpy", "rcl_interfaces", "std_msgs", "sensor_msgs", "builtin_interfaces")
WITHOUT_ROS = [
    f"pam_orthosis.{path.relative_to(PACKAGE).with_suffix('').as_posix().replace('/', '.')}"
    for room in ("model", "control", "bag", "scene", "cli")
    for path in sorted((PACKAGE / room).rglob("*.py"))
    if path.name != "__init__.py"
]


def test_what_needs_no_graph_imports_no_ros():
    assert "pam_orthosis.control.position" in WITHOUT_ROS
    code = "import sys\n" + "".join(f"sys.modules[{name!r}] = None\n" for name in BLOCKED)
    code += "".join(f"import {name}\n" for name in WITHOUT_ROS)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


@pytest.mark.parametrize("path", sorted((PACKAGE / "nodes").glob("*.py")), ids=lambda p: p.stem)
def test_nodes_hold_no_mathematics_and_controllers_no_plant(path):
    imports = list(_imports(path))
    roots = {name.split(".")[0] for name in imports}
    assert not roots & {"casadi", "scipy", "numpy", "math"}
    if path.stem not in ("plant_simulator", "dummy_driver"):
        assert "pam_orthosis.model.plant" not in imports


def test_only_the_recorder_listens_to_the_truth():
    truth = next(topic for topic in TOPICS if topic.name == "truth")
    assert truth.subscribers == (RECORDER,)


def test_controllers_get_no_parameter_of_the_plant(tmp_path):
    launch.commands(tmp_path, load(), tmp_path / "bag", "default", launch.Mode())
    for name in NODES:
        text = (tmp_path / f"{name}.yaml").read_text()
        assert ("plant." in text) == (name in (PLANT, RECORDER))
        assert ("plant" in LAYOUT[name].branches) == (name in (PLANT, RECORDER))


def test_every_topic_is_made_and_used_by_nodes_of_the_table():
    for topic in TOPICS:
        assert set(topic.producers) | set(topic.subscribers) <= set(NODES)
        assert topic.meaning
        assert topic.unit


def test_no_writer_forgets_what_the_recorder_may_still_lack():
    pace = pytest.importorskip("pam_orthosis.nodes.pace")
    assert pace.MAX_UNRECORDED_STEPS < PUBLISHED_DEPTH
