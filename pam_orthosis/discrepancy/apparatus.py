# SPDX-License-Identifier: Apache-2.0
"""What recordings are of: knee, test rig or a machine of a user's file, and its nominal parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pam_orthosis.bag.bounded import check_bag
from pam_orthosis.bag.legs import check_named, joint_beside
from pam_orthosis.bag.read import machine_of, recorded_parameters, run_record
from pam_orthosis.bag.topics import JOINT
from pam_orthosis.discrepancy.answer.patch import PLANNED
from pam_orthosis.discrepancy.recordings import rig_bags
from pam_orthosis.discrepancy.recordings.data import Recording, recording
from pam_orthosis.discrepancy.systems import declared, knee, rig
from pam_orthosis.discrepancy.systems.system import Source, System
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import NOMINAL, Parameters, load
from pam_orthosis.reading import check_file
from pam_orthosis.tables import is_table


@dataclass(frozen=True)
class Apparatus:
    """What recordings are of.

    Attributes:
        name: for users.
        system: (parameters, effects that may be missing or None for all, whether what acts from outside is
            recorded) -> what the workflow searches.
        keys: how the keys of the nominal model begin that recordings share.
        alone: key -> why recordings that differ in it cannot be used together, whatever the user gives.
        machine: whose parameters these are.
        read: (path, system, namespace) -> a recording.
    """

    name: str
    system: Callable[..., System]
    keys: tuple[str, ...]
    alone: Mapping[str, str] = field(default_factory=dict)
    machine: Machine = KNEE
    read: Callable[[Path, System, str], Recording] = recording

    def nominal(
        self, paths: Sequence[Path], given: Mapping[str, Any], namespace: str = "", named: Path | None = None
    ) -> Parameters:
        """Return the nominal model that recordings agree on, with what the user gives.

        A plan is of one motion, which the recordings need not show, and no part of the apparatus.

        Args:
            named: file that a refusal names, if not the first recording.
        """
        given = {key: value for key, value in given.items() if not key.startswith(PLANNED)}
        recorded = agreed_nominal(paths, self.keys, given, namespace, self.alone)
        with naming(named or paths[0]):
            return load({**recorded, **given}, self.machine)


def apparatus_of(paths: Sequence[Path], machine: Machine | None = None, namespace: str = "") -> Apparatus:
    """Return what recordings are of; tables are of `machine`, or of the knee.

    Raises:
        OrthosisError: of several apparatus; or a bag was recorded with another file than the given one, or
            holds several machines and no namespace is given.
    """
    kinds = [_apparatus(path, machine, namespace) for path in paths]
    others = {(one.name, one.machine.text) for one in kinds}
    if len(others) > 1:
        names = ", ".join(sorted(name for name, _ in others))
        raise OrthosisError(f"recordings of different systems ({names}): one at a time")
    return kinds[0]


def _apparatus(path: Path, given: Machine | None, namespace: str) -> Apparatus:
    if is_table(path):
        check_file(path)
    else:
        check_bag(path)
        check_named(path, namespace)
    run = {} if is_table(path) else run_record(path, namespace)
    recorded = machine_of(path, run)
    if given and run and recorded.text != given.text:
        raise OrthosisError(f"{path} was recorded with another file, of {recorded.name}: leave --machine out")
    machine = given or recorded
    if machine is not KNEE:
        return _of_machine(path, machine, namespace)
    specimen = rig_bags.specimen_of(path)
    if specimen is None:
        return Apparatus("the knee", knee.knee, knee.APPARATUS, knee.ALONE)
    return Apparatus(
        f"a rig with a {specimen}",
        lambda p, *_: rig.test_rig(p, specimen),
        rig.APPARATUS,
        read=rig_bags.recording,
    )


def _of_machine(path: Path, machine: Machine, namespace: str) -> Apparatus:
    """Return a machine that is not the shipped knee, as an apparatus."""
    if machine.coupled:
        topic, joint = joint_beside(path, namespace, machine)
        beside = Source(topic=topic, type=JOINT, field="position", joint=joint)
        name = f"the {machine.name} of a {machine.coupled}"
        return Apparatus(
            name,
            lambda *given: declared.coupled_joint(machine, beside, *given),
            declared.APPARATUS,
            machine=machine,
        )
    if machine.kind == "knee":
        if machine.names != KNEE.names:
            raise OrthosisError(f"{machine.name}: gap knows a knee by its {' and '.join(KNEE.names)} alone")
        return Apparatus(machine.name, knee.knee, knee.APPARATUS, knee.ALONE, machine)
    return Apparatus(
        machine.name,
        lambda *given: declared.declared_machine(machine, *given),
        declared.APPARATUS,
        machine=machine,
    )


def recorded_nominal(path: Path, namespace: str = "") -> dict[str, Any]:
    """Return the nominal model that a bag of ours was recorded with, as overrides; empty for another file.

    `namespace`: of the leg whose nominal model it is.
    """
    if is_table(path):
        return {}
    recorded = recorded_parameters(path, run_record(path, namespace), namespace)
    return {key: value for key, value in recorded.items() if key.split(".", 1)[0] in (*NOMINAL, "rig")}


def without_record(paths: Sequence[Path], namespace: str = "") -> list[Path]:
    """Return the recordings without a record of their apparatus: it is assumed."""
    return [path for path in paths if not recorded_nominal(path, namespace)]


def unrecorded(
    paths: Sequence[Path],
    parameters: Parameters,
    keys: tuple[str, ...],
    given: Collection[str] = (),
    namespace: str = "",
) -> dict[str, float]:
    """Return the rows of the apparatus that a bag with a record says nothing of, and the value that is taken.

    An older version recorded the bag, which did not have them. Effects that are off are left out.
    """
    records = [nominal for path in paths if (nominal := recorded_nominal(path, namespace))]
    taken = {k: v for k, v in parameters.flat().items() if k.startswith(keys) and k not in given}
    return {
        key: value
        for key, value in taken.items()
        if not _is_off(key, taken) and any(key not in record for record in records)
    }


def agreed_nominal(
    paths: Sequence[Path],
    apparatus: tuple[str, ...],
    given: Collection[str] = (),
    namespace: str = "",
    alone: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the nominal model of the first bag that has one, as overrides; empty if none has.

    What it does not record of the apparatus is that of the next bag that does.

    Args:
        apparatus: how the keys begin that must have one value in all bags.
        given: keys whose values the user gives.
        namespace: of the leg in the bags.
        alone: key -> why bags that differ in it cannot be used together, whatever the user gives.

    Raises:
        OrthosisError: bags of different apparatus.
    """
    alone = alone or {}
    known = [(path, nominal) for path in paths if (nominal := recorded_nominal(path, namespace))]
    first, nominal = known[0] if known else (None, {})
    source = dict.fromkeys(nominal, first)
    for path, other in known[1:]:
        for key, value in nominal.items():
            settled = key in given and key not in alone
            if not key.startswith(apparatus) or settled or _is_off(key, nominal, other):
                continue
            if key in other and other[key] != value:
                help_ = "give recordings of one, or the value that is right with --model"
                raise OrthosisError(
                    f"recordings of different apparatus: {key} is {value} in {source[key]}, {other[key]} in"
                    f" {path}; {alone.get(key, help_)}"
                )
        more = {k: v for k, v in other.items() if k.startswith(apparatus) and k not in nominal}
        nominal, source = nominal | more, source | dict.fromkeys(more, path)
    return nominal


def _is_off(key: str, *models: Mapping[str, Any]) -> bool:
    """Return whether a key is of an effect that no nominal model has switched on."""
    branch, _, rest = key.partition("effects.")
    switch = f"{branch}effects.{rest.split('.', 1)[0]}.enabled"
    return bool(rest) and not any(one.get(switch) for one in models)
