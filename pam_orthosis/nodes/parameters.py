# SPDX-License-Identifier: Apache-2.0
"""Rows of `config/` as ROS parameters with description, unit and range, and back."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import machine_named, read_machine
from pam_orthosis.model.parameters import Parameters, Row, load
from pam_orthosis.nodes.layout import NodeSpec

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class Setting(NamedTuple):
    """A node's own parameter: default and meaning."""

    default: float | str | bool
    meaning: str


LEGS = Setting("", "namespaces of the legs, and in which parameters each differs, as JSON; none: one")
OF_FILE = f"YAML file of the machine whose graph this is; none: the {machine_named().name}"
MACHINE = {"machine_file": Setting("", OF_FILE)}


def machine_of(settings: Mapping[str, Any]) -> Machine:
    """Return the machine of a node with the settings `MACHINE`; OrthosisError if its file is unusable."""
    file = settings["machine_file"]
    return read_machine(Path(file)) if file else machine_named()


def declare_settings(node: Node, settings: Mapping[str, Setting]) -> dict[str, Any]:
    """Declare a node's own parameters, and return what they are set to; OrthosisError for unusable ones."""
    values = {}
    for name, (default, meaning) in settings.items():
        descriptor = ParameterDescriptor(description=meaning, read_only=True)
        values[name] = _declare(node, name, default, descriptor)
        if isinstance(values[name], float) and not 0 < values[name] < float("inf"):
            raise OrthosisError(f"{node.get_name()}: parameter {name} must be a positive number")
    return values


def declare_rows(node: Node, machine: Machine, spec: NodeSpec) -> Parameters:
    """Declare a node's own rows and those that it was given; return the branches that it may know.

    A row of the apparatus that nobody gives has the value of `config/`, and no node declares it: there are
    hundreds. Rows but the live ones cannot be set later. To be called last: a parameter that is then set but
    not declared is an OrthosisError, as is an unusable value.
    """
    known = load({}, machine).only(*spec.branches)
    given = node._parameter_overrides  # rclpy keeps those of no declared parameter silently, and only here
    values = {
        row.key: _plain(_declare(node, row.key, row.value, _descriptor(row, row.key in spec.live)))
        for row in known.rows()
        if spec.owns(row.key) or row.key in given
    }
    for name in given:
        if not node.has_parameter(name) and not name.startswith(_OF_ROS):
            raise OrthosisError(f"{node.get_name()} has no parameter {name}: check its name in config/")
    return load(values, machine).only(*spec.branches) if given.keys() & values.keys() else known


def take_changes(node: Node, live: Collection[str], take: Callable[[dict[str, Any]], None]) -> None:
    """Pass later settings of `live` parameters, name -> value, to `take`.

    An OrthosisError that `take` raises refuses the settings, all of them, with its text as the reason.
    """

    def on_set(parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters if parameter.name in live}
        try:
            if changes:
                take(changes)
        except OrthosisError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def _declare(node: Node, name: str, default: Any, descriptor: ParameterDescriptor) -> Any:
    try:
        return node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise OrthosisError(f"{node.get_name()}: {error}") from error


def _descriptor(row: Row, live: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=f"{row.meaning} [{row.unit}]",
        additional_constraints=_constraints(row, live),
        read_only=not live,
    )
    if row.minimum is None or row.maximum is None or isinstance(row.value, list):
        return descriptor
    if isinstance(row.value, int):
        descriptor.integer_range = [IntegerRange(from_value=row.minimum, to_value=row.maximum)]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(row.minimum), to_value=float(row.maximum))
        ]
    return descriptor


def _constraints(row: Row, live: bool) -> str:
    options = [f"one of {', '.join(row.options)}"] if row.options else []
    when = "may be set while the node runs" if live else "fixed for a run: set it before the start"
    return "; ".join([*options, when])


def _plain(value: Any) -> Any:
    """Return a Python value: lists come back from ROS as arrays."""
    return value if isinstance(value, bool | int | float | str) else list(value)
