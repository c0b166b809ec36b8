# SPDX-License-Identifier: Apache-2.0
"""Signals of the test rig and the topics that they are on, beside those of other machines in `bag.topics`.

Same conventions: stamped standard types, truth on a topic of its own that identification never reads.
"""

from pam_orthosis.bag.topics import JOINT, MOTION, PRESSURE, VECTOR, WRENCH, Signal

NAMESPACE, CARRIAGE = "rig", "carriage"
MUSCLES = "specimen", "positioner"


def _signal(name: str, topic: str, type_: str, field: str, unit: str, joint: str = "") -> Signal:
    return Signal(f"{NAMESPACE}_{name}", f"{NAMESPACE}/{topic}", field, joint, unit, type_)


def _pressure(name: str, topic: str) -> Signal:
    return _signal(name, topic, PRESSURE, "fluid_pressure", "Pa")


def _flow(name: str, topic: str) -> Signal:
    return _signal(name, f"{topic}/mass_flow", VECTOR, "vector.x", "kg/s")


def _voltage(name: str, muscle: str) -> Signal:
    own = _signal(name, f"{muscle}/valve_command", JOINT, "position", "V", f"{muscle}_valve")
    return own._replace(spool=True)


_SIGNALS = (  # in the order of the topics in a bag
    _signal("position", "joint_states", JOINT, "position", "m", CARRIAGE),
    _pressure("pressure", "specimen/pressure"),
    _pressure("positioner_pressure", "positioner/pressure"),
    _signal("force", "specimen/force", WRENCH, "wrench.force.x", "N"),
    _signal("diameter", "specimen/cylinder", JOINT, "position", "m", "diameter"),
    _signal("cylinder_length", "specimen/cylinder", JOINT, "position", "m", "length"),
    _signal("truth_position", "truth", JOINT, "position", "m", CARRIAGE),
    _signal("truth_velocity", "truth", JOINT, "velocity", "m/s", CARRIAGE),
    _signal("truth_force", "truth", JOINT, "effort", "N", "specimen"),
    _signal("truth_positioner_force", "truth", JOINT, "effort", "N", "positioner"),
    *(_pressure(f"truth_{name}_pressure", f"truth/{name}/pressure") for name in MUSCLES),
    *(_flow(f"truth_{name}_flow", f"truth/{name}") for name in MUSCLES),
    _signal("reference_position", "reference", MOTION, "positions", "m", CARRIAGE),
    _signal("reference_velocity", "reference", MOTION, "velocities", "m/s", CARRIAGE),
    _signal("reference_acceleration", "reference", MOTION, "accelerations", "m/s^2", CARRIAGE),
    _pressure("pressure_reference", "specimen/pressure_reference"),
    _signal("estimate_position", "estimate", JOINT, "position", "m", CARRIAGE),
    _signal("estimate_velocity", "estimate", JOINT, "velocity", "m/s", CARRIAGE),
    *(_flow(f"{name}_mass_flow", name) for name in MUSCLES),
    _voltage("voltage", "specimen"),
    _voltage("positioner_voltage", "positioner"),
)
RIG_SIGNALS = {signal.name: signal for signal in _SIGNALS}
