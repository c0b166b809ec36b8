# SPDX-License-Identifier: Apache-2.0
"""The whole device in the real graph: one start, one emergency stop, one reset, one end, one bag."""

import os
import signal
from pathlib import Path

import numpy as np
from live_runs import QUICK, common

from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import read_bag
from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.device import device_named, entry_of
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch

DEVICE = device_named(Path("device"))
RETURN = {"control.guard.rise_time": 0.3, "control.guard.return_speed": 2.0}
EMPTY_PA, VENTED_S = 1.2e5, 0.4  # absolute; as docs/explanation/machines.md states
LOADED_PA, FOLLOWS_DEG = 1.8e5, 3.0
BACK_S, WALKED_S = 3.0, 2.0


def test_one_node_emulates_all_and_each_joint_has_its_own_controllers(tmp_path):
    parameters = device_parameters(DEVICE, {})
    legs = {name: entry_of(one) for name, one in parameters.items()}

    def started(mode):
        return launch.commands(tmp_path, parameters["left/knee"], tmp_path / "bag", "default", mode)

    commands = started(launch.Mode(legs=legs, one_plant=True))
    assert sorted(name for name in commands if "/" not in name) == ["bag_recorder", "plant_simulator"]
    for name, one in parameters.items():
        own = {f"{muscle}_pressure_controller" for muscle in one.declared.names}
        own |= {"position_controller", "trajectory_publisher", "inverse_valve_model"}
        assert {f"{name}/{node}" for node in own} == {
            each for each in commands if each.startswith(f"{name}/")
        }
    ((process, command),) = started(launch.Mode(composed=True, legs=legs, one_plant=True)).items()
    assert process == launch.COMPOSED
    assert set(commands) == set(command[4 : command.index("--ros-args")])


def test_an_emergency_stop_at_one_joint_empties_all_and_after_one_reset_all_walk(caller, live_run):
    changes = [word for key, value in RETURN.items() for word in ("--param", f"{key}={value}")]
    run = live_run("--machine", "device", "--open", "--composed", *QUICK, *changes)
    run.wait_until_it_records()
    caller.let_pass(0.8)
    assert caller.trigger("left/knee/inverse_valve_model/emergency_stop").success
    caller.let_pass(0.6)
    assert caller.trigger("plant_simulator/reset").success
    caller.let_pass(BACK_S + WALKED_S)
    os.kill(run.process.pid, signal.SIGINT)
    status, said = run.ended()
    assert (status, "interrupted" in said) == (3, True)
    assert len(list(run.bag.glob("*.mcap"))) == 1
    _assert_story({name: _course(run.bag, name) for name in namespaces(run.bag)})


def _course(bag, name):
    """Return time, s, true pressures, Pa, whether all valves vent, and the error, deg, of a machine."""
    machine = DEVICE.joints[name.rpartition("/")[2]]
    kinds = "{}_voltage", "truth_{}_pressure"
    names = [kind.format(one) for kind in kinds for one in machine.names]
    recorded = read_bag(bag, [*names, "angle", "followed_angle"], namespace=name)
    stamps, (first, second, *pressures, angle, followed) = common(*recorded.series.values())
    vent = load({}, machine).valve.minimum_voltage
    vents = (first == vent) & (second == vent)
    return stamps * 1e-9, np.array(pressures), vents, np.degrees(np.abs(followed - angle))


def _assert_story(courses):
    """All are loaded, empty soon after the stop, and loaded again; a joint then follows its reference."""
    assert len(courses) == 6
    length = min(len(time) for time, *_ in courses.values())
    time = next(iter(courses.values()))[0][:length]
    all_vent = np.all([vents[:length] for _, _, vents, _ in courses.values()], axis=0)
    (stopped,) = np.nonzero(all_vent & (time < time[-1] - 1.0))  # in the end it vents too
    begun, over = time[stopped[0]], time[stopped[-1]]
    assert over - begun >= load().control.guard.rest_time
    for name, (at, pressures, _, error) in courses.items():
        assert pressures[:, at < begun].max() > LOADED_PA, name
        assert pressures[:, (at > begun + VENTED_S) & (at < over)].max() < EMPTY_PA, name
        walks = (at > over + BACK_S) & (at < time[-1] - 1.0)
        assert walks.sum() > 100, name
        assert pressures[:, walks].max() > LOADED_PA, name
        assert error[walks].max() < FOLLOWS_DEG, name
