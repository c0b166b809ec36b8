# SPDX-License-Identifier: Apache-2.0
"""Topics and signals of the test rig, beside those of other machines in `bag.topics`.

Same conventions: stamped standard types, truth on a topic of its own that identification never reads.
"""

from pam_orthosis.bag.topics import JOINT, MOTION, PRESSURE, VECTOR, WRENCH, Signal, Topic, typed

NAMESPACE = "rig"
MUSCLES = "specimen", "positioner"


def _topic(name: str, type_: str, meaning: str, unit: str) -> Topic:
    return Topic(f"{NAMESPACE}/{name}", type_, (NAMESPACE,), (), meaning, unit)


RIG_TOPICS = (
    _topic("joint_states", JOINT, "measured position of the carriage", "m"),
    _topic("specimen/pressure", PRESSURE, "measured pressure of the investigated muscle", "Pa"),
    _topic("positioner/pressure", PRESSURE, "measured pressure of the MAS-40", "Pa"),
    _topic("specimen/force", WRENCH, "load cell, force along x", "N"),
    _topic("specimen/cylinder", JOINT, "calliper: diameter and length of the cylinder", "m"),
    _topic("truth", JOINT, "state of the emulated rig", "SI"),
    *(_topic(f"truth/{name}/pressure", PRESSURE, "true pressure", "Pa") for name in MUSCLES),
    *(_topic(f"truth/{name}/mass_flow", VECTOR, "true mass flow, x into it", "kg/s") for name in MUSCLES),
    _topic("reference", MOTION, "position to follow", "m, m/s, m/s^2"),
    _topic("specimen/pressure_reference", PRESSURE, "pressure to hold", "Pa"),
    _topic("estimate", JOINT, "observer: position, velocity", "m, m/s"),
    *(_topic(f"{name}/mass_flow", VECTOR, "mass flow to reach, x into it", "kg/s") for name in MUSCLES),
    *(_topic(f"{name}/valve_command", JOINT, "position of the valve's spool", "1") for name in MUSCLES),
)


def _signal(name: str, topic: str, field: str, joint: str, unit: str) -> Signal:
    return Signal(f"{NAMESPACE}_{name}", f"{NAMESPACE}/{topic}", field, joint, unit)


def _voltage(name: str, muscle: str) -> Signal:
    topic, joint = f"{muscle}/valve_command", f"{muscle}_valve"
    return _signal(name, topic, "position", joint, "V")._replace(spool=True)


_SIGNALS = (
    _signal("position", "joint_states", "position", "carriage", "m"),
    _signal("pressure", "specimen/pressure", "fluid_pressure", "", "Pa"),
    _signal("positioner_pressure", "positioner/pressure", "fluid_pressure", "", "Pa"),
    _signal("force", "specimen/force", "wrench.force.x", "", "N"),
    _signal("diameter", "specimen/cylinder", "position", "diameter", "m"),
    _signal("cylinder_length", "specimen/cylinder", "position", "length", "m"),
    _voltage("voltage", "specimen"),
    _voltage("positioner_voltage", "positioner"),
    _signal("reference_position", "reference", "positions", "carriage", "m"),
    _signal("pressure_reference", "specimen/pressure_reference", "fluid_pressure", "", "Pa"),
    _signal("estimate_velocity", "estimate", "velocity", "carriage", "m/s"),
    _signal("truth_position", "truth", "position", "carriage", "m"),
    _signal("truth_force", "truth", "effort", "specimen", "N"),
)
RIG_SIGNALS = typed(_SIGNALS, RIG_TOPICS)
