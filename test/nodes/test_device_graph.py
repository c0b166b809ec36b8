# SPDX-License-Identifier: Apache-2.0
"""The nodes of the whole device: those of each joint in its namespace, one plant, one recorder."""

from pathlib import Path

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.device import device_named, entry_of
from pam_orthosis.nodes import launch


def test_one_node_emulates_all_and_each_joint_has_its_own_controllers(tmp_path):
    parameters = device_parameters(device_named(Path("device")), {})
    legs = {name: entry_of(one) for name, one in parameters.items()}
    mode = launch.Mode(legs=legs, one_plant=True)
    commands = launch.commands(tmp_path, parameters["left/knee"], tmp_path / "bag", "default", mode)
    assert sorted(name for name in commands if "/" not in name) == ["bag_recorder", "plant_simulator"]
    for name, one in parameters.items():
        own = {f"{muscle}_pressure_controller" for muscle in one.declared.names}
        own |= {"position_controller", "trajectory_publisher", "inverse_valve_model"}
        assert {f"{name}/{node}" for node in own} == {
            each for each in commands if each.startswith(f"{name}/")
        }
