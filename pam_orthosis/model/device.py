# SPDX-License-Identifier: Apache-2.0
"""A device: machines that run together, some of them joints of one mechanism, as one file declares them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import check_name, machine_from, machine_named
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.reading import check_keys, config_folder, from_json, from_yaml, mapping, read_text

TOP = ("meaning", "sides", "joints", "values")
OF_SHIPPED = "plant.effects.", "valve.delay"  # what a machine of a user's file has by itself
OF_JOINT = ("machine", "coupled", "parallel")
MACHINE = ("machine", "machine_name")  # what a namespace's entry holds beside its parameters
FOLDER = "devices"


@dataclass(frozen=True)
class Device:
    """Machines by the namespace of their nodes; `sides` are the namespaces around them, if there are any."""

    name: str
    sides: tuple[str, ...]
    joints: Mapping[str, Machine]


def shipped_devices() -> list[str]:
    """Return the names of the shipped devices."""
    return sorted(path.stem for path in (config_folder() / FOLDER).glob("*.yaml"))


def device_named(name: Path) -> Device | None:
    """Return the device of a file or, where there is none, the shipped one; None: it declares one machine.

    Raises:
        OrthosisError: an entry that is missing, unknown or unusable.
    """
    shipped = config_folder() / FOLDER / f"{name}.yaml"
    path = shipped if not name.exists() and str(name) in shipped_devices() else name
    if not path.exists():
        return None
    tree = from_yaml(read_text(path), str(path))
    if not isinstance(tree, dict) or "joints" not in tree:
        return None
    check_keys(mapping(tree, f"{path}: a device"), TOP, f"{path}: a device")
    sides = tree.get("sides", [""])
    if not isinstance(sides, list) or not sides or not all(isinstance(side, str) for side in sides):
        raise OrthosisError(f"{path}: sides is a list of names")
    joints = mapping(tree["joints"], f"{path}: joints")
    values = mapping(tree.get("values", {}), f"{path}: values")
    made = {key: _joint(path, key, node, values) for key, node in joints.items()}
    return Device(path.stem, tuple(sides), made)


def parameters_of(entry: Mapping[str, Any], shared: Parameters) -> Parameters:
    """Return the parameters of a namespace, by an entry of `legs` of a run.

    It holds a machine and all its values, or in which values the namespace differs from the shared ones.

    Raises:
        OrthosisError: an unusable machine or value.
    """
    if MACHINE[0] not in entry:
        return shared.changed(entry)
    text, name = (entry[key] for key in MACHINE)
    machine = machine_from(text, name, f"the machine {name}")
    return load({key: value for key, value in entry.items() if key not in MACHINE}, machine)


def legs_from(text: str, who: str) -> dict[str, dict[str, Any]]:
    """Return the entry of each namespace of a node's `legs`; OrthosisError if that has another form."""
    legs = from_json(text or '{"": {}}', f"{who}: legs")
    if not isinstance(legs, dict) or not all(isinstance(own, dict) for own in legs.values()) or not legs:
        raise OrthosisError(f'{who}: legs must be like {{"left": {{}}, "right": {{"leg.shank.mass": 4.0}}}}')
    return legs


def of_joint(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a joint's share of values: `ankle/KEY` is of the joint `ankle`, KEY of all."""
    own = {key.removeprefix(f"{name}/"): value for key, value in values.items()}
    return {key: value for key, value in own.items() if "/" not in key}


def entry_of(parameters: Parameters) -> dict[str, Any]:
    """Return what `parameters_of` makes these parameters of."""
    machine = parameters.declared
    return dict(zip(MACHINE, (machine.text, machine.name), strict=True)) | parameters.flat()


def _joint(path: Path, name: str, node: Any, values: Mapping[str, Any]) -> Machine:
    """Return a joint's machine: that of another file; if it is coupled, with the values of the device."""
    where = f"{path}: joint {name}"
    check_name(name, f"{path}: a joint")
    node = mapping(node, where)
    check_keys(node, OF_JOINT, where)
    base = machine_named(Path(str(node.get("machine"))))
    text = base.text or read_text(config_folder() / "machines" / f"{base.name}.yaml")
    tree = mapping(from_yaml(text, where), where)
    shipped = {key: value for key, value in load().flat().items() if key.startswith(OF_SHIPPED)}
    tree["values"] = ({} if base.text else shipped) | dict(base.values)
    for one in tree["actuators"].values():
        one["parallel"] = node.get("parallel", 1)
    if "coupled" in node:
        tree.pop("experiments", None)  # they are of the knee alone
        tree["coupled"] = node["coupled"]
        tree["values"] |= of_joint(name, values)
    return machine_from(yaml.safe_dump(tree, sort_keys=False), base.name, where)
