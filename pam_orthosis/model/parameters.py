# SPDX-License-Identifier: Apache-2.0
"""Parameters: every value a row with unit, bounds, meaning and source, in one tree.

The tree has one branch a file of `config/`. The branches `muscle`, `valve`, `leg`, `control` and
`effects` are the nominal model (all that controllers know); `rig` is the nominal model about the test rig;
`plant` is the truth of the emulated hardware; `scenario` says what a run does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.markup import table
from pam_orthosis.model.rows import Row, Section, Value
from pam_orthosis.reading import config_folder, mapping, meant, read_yaml

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

__all__ = [
    "NOMINAL", "SUBJECTS", "Parameters", "Row", "Section", "Value", "config_folder", "experiments", "load",
    "scenario_names", "scenario_overrides",
]  # fmt: skip
SUBJECTS = ("muscle", "valve", "leg", "control", "rig", "plant", "scenario", "gap")
# nodes know no rig; the rig's controllers know these and their rig
NOMINAL = ("muscle", "valve", "leg", "control", "effects", "scenario", "machine")
# rows that a machine of another file has by its own effects, or not at all; see `mechanisms.all_rows`
OF_SHIPPED = ("rig.", "plant.rig.", "plant.effects.", "plant.person.tissue.", "effects.")


class Parameters(Section):
    """The whole tree of a machine, or the part of it that a component may know."""

    def __init__(self, declared: Machine, rows: Mapping[str, Row], values: Mapping[str, Any] | None = None):
        self._declared = declared
        self._rows = dict(rows)
        self._values = {key: row.value for key, row in rows.items()}
        self._values.update(values or {})
        super().__init__("parameters", _nested(self._values))

    @property
    def declared(self) -> Machine:
        """The machine whose parameters these are."""
        return self._declared

    def row(self, key: str) -> Row:
        """Return the row of a dotted key; OrthosisError if there is none."""
        if key not in self._rows:
            raise _unknown(key, self._rows)
        return self._rows[key]

    def at(self, key: str) -> Any:
        """Return the value or the branch at a dotted key; OrthosisError if there is none."""
        found: Any = self
        for step in key.split("."):
            found = getattr(found, step)
        return found

    def rows(self) -> list[Row]:
        """Return all rows in the order of the files."""
        return list(self._rows.values())

    def flat(self) -> dict[str, Any]:
        """Return dotted key -> value."""
        return dict(self._values)

    def changes(self) -> dict[str, Any]:
        """Return dotted key -> value of those that differ from the machine's of `config/`."""
        shipped = load({}, self._declared).flat()
        return {key: value for key, value in self._values.items() if shipped.get(key) != value}

    def accepted(self, key: str, value: Any) -> Any:
        """Return a value as the row of its key takes it; another key's as it is (of another version, say)."""
        return self._rows[key].with_value(value).value if key in self._rows else value

    def only(self, *branches: str) -> Parameters:
        """Return the tree with no other branches than these."""
        kept = {k: r for k, r in self._rows.items() if k.split(".", 1)[0] in branches}
        return Parameters(self._declared, kept, {k: v for k, v in self._values.items() if k in kept})

    def nominal(self) -> Parameters:
        """Return what controllers and identification may know: no plant."""
        return self.only(*NOMINAL)

    def rig_nominal(self) -> Parameters:
        """Return what the test rig's controllers may know: no plant."""
        return self.only(*NOMINAL, "rig")

    def changed(self, overrides: Mapping[str, Any]) -> Parameters:
        """Return the tree with other values, each checked against its row and the rules.

        Raises:
            OrthosisError: unknown key, unusable value or a broken rule between values.
        """
        from pam_orthosis.model.rules import broken_rules  # --help needs none of them

        result = Parameters(self._declared, self._rows | _with_values(self._rows, overrides))
        try:
            broken = list(broken_rules(result.flat(), self._declared))
        except (TypeError, IndexError, KeyError) as error:  # a row in config/ of another kind, or gone
            raise OrthosisError(f"config/: a value is of the wrong kind or missing ({error})") from error
        for message in broken:
            raise OrthosisError(message)
        return result

    def substituted(self, values: Mapping[str, Any]) -> Parameters:
        """Return the tree with values replaced unchecked, e.g. by CasADi symbols for sensitivities."""
        for key in values:
            self.row(key)
        return Parameters(self._declared, self._rows, {**self._values, **values})

    def symbolic(self, keys: Sequence[str]) -> tuple[Parameters, Any]:
        """Return the tree with symbols in place of the values of these keys, and the vector of symbols."""
        import casadi as ca  # takes a second to load

        symbols = ca.SX.sym("live", len(keys))
        return self.substituted(dict(zip(keys, ca.vertsplit(symbols), strict=True))), symbols

    def __repr__(self) -> str:
        return f"{self._counted(len(self.changes()))}\n{super().__repr__()}"

    def _repr_html_(self) -> str:
        changed = [self._rows[key] for key in self.changes()]
        rows = [(row.key, f"{self._values[row.key]}", row.unit, row.meaning) for row in changed]
        return table(("parameter", "value", "unit", "meaning"), rows, self._counted(len(rows)))

    def _counted(self, changed: int) -> str:
        return f"{self._declared.name}: {len(self._rows)} parameters, {changed} of them changed"


def load(overrides: Mapping[str, Any] | None = None, machine: Machine | None = None) -> Parameters:
    """Return the shipped parameters with dotted-key overrides, or those of a machine of another file.

    Raises:
        OrthosisError: unknown key, wrong type, not finite, out of bounds or inconsistent values.
    """
    from pam_orthosis.model.machines import machine_named  # --help needs none of them

    declared = machine or machine_named()
    parameters = Parameters(declared, _rows_for(declared) if declared.text else _shipped_rows())
    with naming(f"the machine {declared.name}"):
        declared.check(parameters)
    return parameters.changed(overrides or {})


def scenario_names() -> dict[str, str]:
    """Return scenario name -> what it shows."""
    return {name: entry["meaning"] for name, entry in _scenarios().items()}


def experiments() -> dict[str, str]:
    """Return scenario name -> how the same is done on an apparatus, for the diagnostic experiments."""
    return {name: entry["apparatus"] for name, entry in _scenarios().items() if "apparatus" in entry}


def scenario_overrides(name: str) -> dict[str, Any]:
    """Return the overrides of a named scenario; OrthosisError if there is no such scenario."""
    scenarios = _scenarios()
    if name not in scenarios:
        raise OrthosisError(f"no scenario {name!r}; there are: {', '.join(scenarios)}")
    return dict(scenarios[name].get("set") or {})


@lru_cache(maxsize=1)
def _shipped_rows() -> dict[str, Row]:
    from pam_orthosis.model.machines import RIG, machine_named  # --help needs none of them

    shipped = machine_named()
    rows: dict[str, Row] = {}
    for subject in SUBJECTS:
        tree = _subject(subject)
        if subject == "plant":
            of_rig = mapping(tree.get("rig"), "config/: rig in plant.yaml")
            own = {name: effect for name, effect in RIG.catalogue.items() if effect.of == "translation"}
            rows.update(_effect_rows("plant.effects", tree.pop("effects", {}), shipped.catalogue))
            rows.update(_effect_rows("plant.rig.effects", of_rig.pop("effects", {}), own))
        rows.update(_rows_of(tree, subject))
    rows.update(_effect_rows("plant.person.tissue", {}, shipped.tissue))
    rows.update(_effect_rows("effects", {}, shipped.possible))
    rows.update(_effect_rows("rig.effects", {}, RIG.possible))
    return rows


def _rows_for(machine: Machine) -> dict[str, Row]:
    """Return the rows that a machine's file gives itself, and those that all machines share."""
    from pam_orthosis.model.mechanisms import all_rows

    effects = machine.catalogue
    rows = {row.key: row for row in machine.rows}
    for subject in machine.subjects:
        for branch, tree in _subject(subject).items():
            rows |= _rows_of(mapping(tree, f"config/: {subject}.yaml"), branch)
    others = tuple(key for key in (*all_rows(), *OF_SHIPPED) if key not in machine.shared_rows)
    shared = {key: row for key, row in _shipped_rows().items() if not key.startswith(others)}
    true = _effect_rows("plant.effects", {}, effects)
    true |= _effect_rows("plant.person.tissue", {}, machine.tissue)
    known = shared | rows | true | _effect_rows(machine.branch, {}, machine.possible)
    with naming(f"values of the machine {machine.name}"):
        known |= _with_values(known, machine.values)
        if not machine.text or "valve.delay" in machine.values:
            return known
        return known | _with_values(known, {"valve.delay": _dead_time(known)})


def _dead_time(rows: Mapping[str, Row]) -> float:
    """Return the dead time of the emulated hardware, from a sample to the flow that answers it, s."""
    parts = ("computing", "converter", "valve", "hose_length", "hose_per_metre")
    one: dict[str, Any] = {part: rows[f"plant.delay.{part}"].value for part in parts}
    hose = one["hose_length"] * one["hose_per_metre"]
    return float(one["computing"] + one["converter"] + one["valve"] + hose)


def _with_values(rows: Mapping[str, Row], values: Mapping[str, Any]) -> dict[str, Row]:
    """Return the rows of some keys with other values; OrthosisError for an unknown key or unusable value."""
    if unknown := [key for key in values if key not in rows]:
        raise _unknown(unknown[0], rows)
    return {key: rows[key].with_value(value) for key, value in values.items()}


def _subject(subject: str) -> dict[str, Any]:
    tree = mapping(read_yaml(config_folder() / f"{subject}.yaml"), f"config/: {subject}.yaml")
    return (
        mapping(tree.get("defaults"), "config/: defaults in scenario.yaml") if subject == "scenario" else tree
    )


@lru_cache(maxsize=1)
def _scenarios() -> dict[str, dict[str, Any]]:
    tree = mapping(read_yaml(config_folder() / "scenario.yaml"), "config/: scenario.yaml")
    scenarios = mapping(tree.get("scenarios"), "config/: scenarios in scenario.yaml")
    for name, entry in scenarios.items():
        where = f"config/: scenario {name} in scenario.yaml"
        if not isinstance(mapping(entry, where).get("meaning"), str):
            raise OrthosisError(f"{where} has no meaning")
        mapping(entry.get("set") or {}, f"set of {where}")
    return scenarios


def _rows_of(tree: Mapping[str, Any], prefix: str) -> dict[str, Row]:
    rows: dict[str, Row] = {}
    for name, node in tree.items():
        key = f"{prefix}.{name}"
        if "value" in mapping(node, f"config/: {key}") and "meaning" in node:
            rows[key] = _row(key, node)
        else:
            rows.update(_rows_of(node, key))
    return rows


def _row(key: str, node: Mapping[str, Any]) -> Row:
    unknown = set(node) - {"value", "unit", "min", "max", "meaning", "source", "options"}
    if unknown:
        raise OrthosisError(f"{key}: unknown field {', '.join(sorted(unknown))} in config/")
    _check_kinds(key, node)
    row = Row(
        key,
        node["value"],
        node.get("unit", "-"),
        node.get("min"),
        node.get("max"),
        node["meaning"],
        node.get("source", ""),
        tuple(node.get("options", ())),
    )
    return row.with_value(row.value)


def _check_kinds(key: str, node: Mapping[str, Any]) -> None:
    """Check the fields of a row; what has bounds is a number or a list of numbers."""
    bounds = [node[name] for name in ("min", "max") if node.get(name) is not None]
    numbers = [
        *bounds,
        *(node["value"] if isinstance(node["value"], list) else [node["value"]] if bounds else []),
    ]
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        raise OrthosisError(f"{key} in config/: value, min and max must be numbers")
    if not isinstance(node["value"], float | int | bool | str | list) or not isinstance(node["meaning"], str):
        raise OrthosisError(f"{key} in config/: value or meaning is of the wrong kind")


def _effect_rows(
    prefix: str, values: Mapping[str, Mapping[str, Any]], catalogue: Mapping[str, Any]
) -> dict[str, Row]:
    rows: dict[str, Row] = {row.key: row for effect in catalogue.values() for row in effect.rows(prefix)}
    given = {
        f"{prefix}.{effect}.{name}": value
        for effect, settings in mapping(values, f"config/: {prefix}").items()
        for name, value in mapping(settings, f"config/: {prefix}.{effect}").items()
    }
    return rows | _with_values(rows, given)


def _nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    branches: dict[str, Any] = {}
    for key, value in flat.items():
        *path, leaf = key.split(".")
        node = branches
        for step in path:
            node = node.setdefault(step, {})
        node[leaf] = value
    return _sections(branches, "")


def _sections(branches: dict[str, Any], path: str) -> dict[str, Any]:
    return {
        name: Section(f"{path}{name}", _sections(node, f"{path}{name}.")) if isinstance(node, dict) else node
        for name, node in branches.items()
    }


def _unknown(key: str, known: Iterable[str]) -> OrthosisError:
    return OrthosisError(f"unknown parameter {key}{meant(key, known)}")
