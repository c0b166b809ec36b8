# SPDX-License-Identifier: Apache-2.0
"""Topics, nodes and signals follow from the machine: the knee's as ever, another's by its names and units."""

from dataclasses import replace

import pytest

from pam_orthosis.bag.fields import check_field
from pam_orthosis.bag.topics import PLANT, POSITION, RECORDER, VALVE, Topics
from pam_orthosis.model.machines import KNEE, read_machine

OF_KNEE = (
    "/clock joint_states extensor/pressure flexor/pressure"
    " truth truth/extensor/pressure truth/extensor/mass_flow truth/flexor/pressure truth/flexor/mass_flow"
    " reference reference_pressure planned_reference estimate disturbance controller_state"
    " extensor/pressure_reference flexor/pressure_reference allowed_pressure"
    " extensor/mass_flow flexor/mass_flow"
    " extensor/valve_command flexor/valve_command answered /diagnostics emergency_stop configuration ready"
    " recorded end"
)
SIGNALS_OF_SLIDE = (
    "position reference_position reference_velocity reference_acceleration followed_position"
    " estimate_position estimate_velocity disturbance truth_position truth_velocity truth_force"
)
OF_ACTUATOR = (
    "{0}_pressure {0}_pressure_reference {0}_mass_flow {0}_voltage truth_{0}_contraction truth_{0}_rate"
    " truth_{0}_force truth_{0}_pressure truth_{0}_flow"
)


@pytest.fixture(scope="module", params=["knee", "slide", "elbow", "three"])
def machine(request, machine_files):
    if request.param == "three":  # the tables are for any number of actuators
        slide = read_machine(machine_files["slide"])
        return replace(slide, actuators=(*slide.actuators, replace(slide.actuators[0], name="third")))
    return KNEE if request.param == "knee" else read_machine(machine_files[request.param])


def test_the_knee_has_the_names_that_bags_and_drivers_know():
    topics = Topics(KNEE)
    assert list(topics.by_name) == OF_KNEE.split()
    assert topics.nodes == (
        "plant_simulator",
        "trajectory_publisher",
        "position_controller",
        "extensor_pressure_controller",
        "flexor_pressure_controller",
        "inverse_valve_model",
        "bag_recorder",
    )
    assert topics.signals["angle"].joint == "knee"
    assert topics.signals["disturbance"].field == "wrench.torque.y"


def test_another_machines_signals_have_its_names_and_units(machine_files):
    topics = Topics(read_machine(machine_files["slide"]))
    of_actuators = [name for one in ("push", "pull") for name in OF_ACTUATOR.format(one).split()]
    assert list(topics.signals) == [*SIGNALS_OF_SLIDE.split(), *of_actuators]
    units = {name: topics.signals[name].unit for name in SIGNALS_OF_SLIDE.split()}
    assert units["reference_acceleration"] == "m/s^2"
    assert (units["truth_force"], units["disturbance"]) == ("N", "N")
    assert topics.signals["disturbance"].field == "wrench.force.x"
    assert topics.signals["position"].joint == "slide"
    assert topics.by_name["joint_states"].meaning == "measured slide position"


def test_every_signal_can_be_read_from_a_message_of_its_topic(machine):
    topics = Topics(machine)
    for signal in topics.signals.values():
        assert signal.type == topics.by_name[signal.topic].type
        check_field(signal)


def test_each_actuator_has_its_controller_and_its_lines(machine):
    topics = Topics(machine)
    assert list(topics.controllers.values()) == list(machine.names)
    for node, name in topics.controllers.items():
        assert set(topics.by_name[f"{name}/pressure"].consumers) == {POSITION, node, VALVE}
        assert topics.by_name[f"{name}/pressure_reference"].consumers == (node,)
        assert topics.by_name[f"{name}/mass_flow"].producers == (node,)
        assert topics.by_name[f"{name}/valve_command"].consumers == (PLANT,)
    assert topics.commands == tuple(f"{name}/valve_command" for name in machine.names)


@pytest.mark.parametrize("mode", [{}, {"realtime": True}, {"realtime": True, "with_plant": False}])
def test_all_who_speak_and_listen_are_nodes_of_the_machine(machine, mode):
    topics = Topics(machine)
    speaking = {node for topic in topics.of_run(**mode).values() for node in topic.producers}
    listening = {node for topic in topics.of_run(**mode).values() for node in topic.subscribers}
    assert speaking | listening == set(topics.nodes)
    assert RECORDER in listening
