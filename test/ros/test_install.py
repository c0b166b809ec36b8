# SPDX-License-Identifier: Apache-2.0
"""The package installs as ROS packages do, with colcon and with pip, and what it installs starts."""

import ast
import os
import re
import shutil
import signal
import sys
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package
from installed import LIMIT_S, ROOT, done, sourced

from pam_orthosis.cli.main import main

EXECUTABLES = {
    "plant_simulator",
    "trajectory_publisher",
    "position_controller",
    "pressure_controller",
    "extensor_pressure_controller",
    "flexor_pressure_controller",
    "inverse_valve_model",
    "safety_monitor",
    "bag_recorder",
    "dummy_driver",
    "leg_state_publisher",
    "live_view",
    "pam-orthosis",
}
LIBRARIES = {"PIL": "pillow", "yaml": "pyyaml"}  # imported by another name


def test_package_xml_is_one_of_ros():
    warnings = []
    package = parse_package(str(ROOT / "package.xml"), warnings=warnings)
    assert package.package_format == 3
    assert package.get_build_type() == "ament_python"
    assert not warnings


def test_package_xml_names_every_message_package_that_is_imported():
    package = parse_package(str(ROOT / "package.xml"))
    named = {dependency.name for dependency in package.exec_depends}
    text = "".join(path.read_text() for path in (ROOT / "pam_orthosis" / "nodes").glob("*.py"))
    imported = {
        line.split()[1].split(".")[0]
        for line in text.splitlines()
        if ".msg import" in line or ".srv import" in line
    }
    assert imported | {"rclpy"} <= named


def test_every_library_that_is_imported_is_declared():
    """In setup.py; what ROS brings, in package.xml."""
    named = {dependency.name for dependency in parse_package(str(ROOT / "package.xml")).exec_depends}
    declared = named | set(re.findall(r'"([a-z0-9]+)>=', (ROOT / "setup.py").read_text()))
    for path in (ROOT / "pam_orthosis").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            roots = {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"pam_orthosis"}
            assert {LIBRARIES.get(root, root) for root in roots} <= declared, path


def test_every_library_comes_from_rosdep_or_from_the_pip_line_of_the_page():
    named = {dependency.name for dependency in parse_package(str(ROOT / "package.xml")).exec_depends}
    page = (ROOT / "docs" / "install.md").read_text()
    (line,) = re.findall(r"^pip install (apsw .*)$", page, re.MULTILINE)
    setup = (ROOT / "setup.py").read_text()
    needed = re.findall(
        r'"([a-z0-9]+)>=', setup[setup.index("install_requires") : setup.index("extras_require")]
    )
    rosdep = {
        "casadi": "casadi-pip",
        "pillow": "python3-pil",
        "pyyaml": "python3-yaml",
        "rosbags": "python3-rosbags-pip",
    }
    from_pip = [one for one in needed if rosdep.get(one, f"python3-{one}") not in named]
    assert sorted(line.split()) == sorted(from_pip)


def test_colcon_installs_every_executable_and_the_marker_of_the_package(install_space):
    prefix = install_space / "pam_orthosis"
    installed = prefix / "lib" / "pam_orthosis"
    assert {path.name for path in installed.iterdir() if os.access(path, os.X_OK)} >= EXECUTABLES
    assert (prefix / "share/ament_index/resource_index/packages/pam_orthosis").exists()
    assert (prefix / "share/pam_orthosis/config/control.yaml").exists()
    assert (prefix / "share/pam_orthosis/launch/one_leg.launch.xml").exists()


def test_an_installed_node_says_what_it_waits_for_and_ends_on_a_signal(install_space):
    pytest.importorskip("rclpy")
    executable = install_space / "pam_orthosis/lib/pam_orthosis/position_controller"
    node = sourced(install_space, [executable])
    line = node.stdout.readline()
    assert "waiting for" in line
    assert "plant_simulator, trajectory_publisher" in line
    node.send_signal(signal.SIGTERM)
    assert node.wait(LIMIT_S) == 0


def test_the_installed_run_walks_and_its_bag_passes(install_space, tmp_path):
    pytest.importorskip("rclpy")
    executable = install_space / "pam_orthosis/lib/pam_orthosis/pam-orthosis"
    run = sourced(install_space, [executable, "run", "--duration", "1", "--out", tmp_path / "bag"])
    said, _ = run.communicate(timeout=LIMIT_S)
    assert run.returncode == 0, said
    assert main(["check", str(tmp_path / "bag")]) == 0


def test_what_is_sourced_is_what_colcon_installed(install_space):
    code = "import pam_orthosis, pam_orthosis.model.parameters as p; print(p.config_folder())"
    python = sourced(install_space, [sys.executable, "-c", code])
    said, _ = python.communicate(timeout=LIMIT_S)
    assert Path(said.strip()).is_relative_to(install_space)


def test_a_wheel_brings_a_relay_to_each_executable_for_ros2_run(tmp_path):
    """`ros2 run` looks into lib/PACKAGE of the prefix; pip puts entry points into bin."""
    source, prefix = tmp_path / "source", tmp_path / "prefix"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "runs", "*.egg-info"))
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--prefix", prefix, source]
    done([*command, "--no-build-isolation", "--ignore-installed"])
    installed = prefix / "lib" / "pam_orthosis"
    assert {path.name for path in installed.iterdir()} == EXECUTABLES
    for name in EXECUTABLES:
        target = prefix / "bin" / name
        target.write_text('#!/bin/sh\necho "$0 $1"\n')
        assert Path(done([installed / name, "-h"]).stdout.split()[0]).samefile(target)
