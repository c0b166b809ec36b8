# SPDX-License-Identifier: Apache-2.0
"""Parameters: every value a row with unit, bounds, meaning and source, in one tree.

The tree has one branch a file of `config/`. The branches `muscle`, `valve`, `leg`, `control` and
`effects` are the belief (all that controllers know); `rig` is the belief about the test rig;
`plant` is the truth of the emulated hardware; `scenario` says what a run does.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import read_yaml, shown

Value = float | int | bool | str | list

SUBJECTS = ("muscle", "valve", "leg", "control", "rig", "plant", "scenario", "gap")
# the knee's nodes know no rig; the rig's controllers know these and their rig
BELIEF = ("muscle", "valve", "leg", "control", "effects", "scenario")


@dataclass(frozen=True)
class Row:
    """One parameter: dotted key, value, unit, bounds (None where there are none), meaning, source."""

    key: str
    value: Value
    unit: str
    minimum: float | None
    maximum: float | None
    meaning: str
    source: str
    options: tuple[str, ...] = ()

    def with_value(self, value: Any) -> Row:
        """Return the row with another value, checked.

        Raises:
            OrthosisError: wrong type, not finite, out of bounds or not one of the options.
        """
        return replace(self, value=self._checked(value))

    def _checked(self, value: Any) -> Value:
        if isinstance(self.value, list):
            return self._checked_list(value)
        if isinstance(self.value, bool) or isinstance(value, bool):
            return self._same_type(value, bool, "true or false")
        if isinstance(self.value, str):
            return self._checked_choice(self._same_type(value, str, "a text"))
        return self._checked_number(value)

    def _checked_list(self, value: Any) -> list[float]:
        if not isinstance(value, list) or len(value) != len(self.value):
            raise OrthosisError(f"{self.key}: give a list of {len(self.value)} numbers, not {shown(value)}")
        return [self._within(self._finite(item)) for item in value]

    def _checked_choice(self, value: str) -> str:
        if self.options and value not in self.options:
            raise OrthosisError(f"{self.key}: {shown(value)} is not one of {', '.join(self.options)}")
        return value

    def _same_type(self, value: Any, kind: type, words: str) -> Any:
        if not isinstance(value, kind) or not isinstance(self.value, kind):
            expected = words if isinstance(self.value, kind) else "a number or text as in config/"
            raise OrthosisError(f"{self.key}: give {expected}, not {shown(value)}")
        return value

    def _finite(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise OrthosisError(f"{self.key}: give a number in {self.unit}, not {shown(value)}")
        try:
            number = float(value)
        except OverflowError:  # a whole number beyond all floating-point ones
            number = math.inf
        if 0.0 < abs(number) < sys.float_info.min:
            raise OrthosisError(f"{self.key}: {shown(value)} is too small a number; give 0 or a larger one")
        if not math.isfinite(number):
            raise OrthosisError(f"{self.key}: {shown(value)} is not a finite number")
        return number

    def _checked_number(self, value: Any) -> float | int:
        number = self._within(self._finite(value))
        if isinstance(self.value, int):
            if number != int(number):
                raise OrthosisError(f"{self.key}: give a whole number, not {shown(value)}")
            return int(number)
        return number

    def _within(self, number: float) -> float:
        for bound, broken in ((self.minimum, number.__lt__), (self.maximum, number.__gt__)):
            if bound is not None and broken(bound):
                raise OrthosisError(
                    f"{self.key} = {number:g} {self.unit} is outside {self.minimum} .. {self.maximum}"
                    f" {self.unit}; check its unit"
                )
        return number


class MissingParameter(AttributeError, OrthosisError):
    """The tree has no such parameter: a name is wrong, or its row has gone from config/."""


class Section:
    """A branch of the tree, read by attribute: `parameters.leg.shank.length`."""

    def __init__(self, path: str, children: dict[str, Any]):
        self.__dict__.update(children)
        self._path = path

    def __getattr__(self, name: str) -> Any:
        raise MissingParameter(f"no parameter {self._path}.{name}: does its row stand in config/?")

    def items(self) -> Iterable[tuple[str, Any]]:
        """Pairs of name and value or branch."""
        return [(k, v) for k, v in self.__dict__.items() if not k.startswith("_")]


class Parameters(Section):
    """The whole tree, or the part of it that a component may know."""

    def __init__(self, rows: Mapping[str, Row], values: Mapping[str, Any] | None = None):
        self._rows = dict(rows)
        self._values = {key: row.value for key, row in rows.items()}
        self._values.update(values or {})
        super().__init__("parameters", _nested(self._values))

    def row(self, key: str) -> Row:
        """Return the row of a dotted key; OrthosisError if there is none."""
        if key not in self._rows:
            raise _unknown(key, self._rows)
        return self._rows[key]

    def rows(self) -> list[Row]:
        """Return all rows in the order of the files."""
        return list(self._rows.values())

    def flat(self) -> dict[str, Any]:
        """Return dotted key -> value."""
        return dict(self._values)

    def accepted(self, key: str, value: Any) -> Any:
        """Return a value as the row of its key takes it; another key's as it is (of another version, say)."""
        return self._rows[key].with_value(value).value if key in self._rows else value

    def only(self, *branches: str) -> Parameters:
        """Return the tree with no other branches than these."""
        kept = {k: r for k, r in self._rows.items() if k.split(".", 1)[0] in branches}
        return Parameters(kept, {k: v for k, v in self._values.items() if k in kept})

    def belief(self) -> Parameters:
        """Return what controllers and identification may know: no plant."""
        return self.only(*BELIEF)

    def rig_belief(self) -> Parameters:
        """Return what the test rig's controllers may know: no plant."""
        return self.only(*BELIEF, "rig")

    def changed(self, overrides: Mapping[str, Any]) -> Parameters:
        """Return the tree with other values, each checked against its row and the rules.

        Raises:
            OrthosisError: unknown key, unusable value or a broken rule between values.
        """
        from pam_orthosis.model.rules import broken_rules  # --help needs none of them

        rows = dict(self._rows)
        for key, value in overrides.items():
            if key not in rows:
                raise _unknown(key, rows)
            rows[key] = rows[key].with_value(value)
        result = Parameters(rows)
        try:
            broken = list(broken_rules(result.flat()))
        except (TypeError, IndexError, KeyError) as error:  # a row in config/ of another kind, or gone
            raise OrthosisError(f"config/: a value is of the wrong kind or missing ({error})") from error
        for message in broken:
            raise OrthosisError(message)
        return result

    def substituted(self, values: Mapping[str, Any]) -> Parameters:
        """Return the tree with values replaced unchecked, e.g. by CasADi symbols for sensitivities."""
        for key in values:
            self.row(key)
        return Parameters(self._rows, {**self._values, **values})


def load(overrides: Mapping[str, Any] | None = None) -> Parameters:
    """Return the shipped parameters with dotted-key overrides.

    Raises:
        OrthosisError: unknown key, wrong type, not finite, out of bounds or inconsistent values.
    """
    return Parameters(_shipped_rows()).changed(overrides or {})


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


def config_folder() -> Path:
    """Return the folder of the shipped YAML files (installed package, or source tree)."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "config"
    return installed if installed.is_dir() else package.parent / "config"


@lru_cache(maxsize=1)
def _shipped_rows() -> dict[str, Row]:
    from pam_orthosis.model.effects import CATALOGUE  # the catalogue needs Row's neighbours
    from pam_orthosis.model.rig_effects import RIG_CATALOGUE

    rows: dict[str, Row] = {}
    for subject in SUBJECTS:
        file = f"{subject}.yaml"
        tree = _mapping(read_yaml(config_folder() / file), file)
        tree = _mapping(tree.get("defaults"), f"defaults in {file}") if subject == "scenario" else tree
        if subject == "plant":
            rows.update(_true_effect_rows(tree))
        rows.update(_rows_of(tree, subject))
    rows.update(_effect_rows("effects", {}, CATALOGUE))
    rows.update(_effect_rows("rig.effects", {}, RIG_CATALOGUE))
    return rows


def _true_effect_rows(plant: dict[str, Any]) -> dict[str, Row]:
    """Take the settings of effects out of the plant's tree; return their rows."""
    from pam_orthosis.model.effects import CATALOGUE
    from pam_orthosis.model.effects.carriage_friction import RIG_EFFECTS

    rows = _effect_rows("plant.effects", plant.pop("effects", {}), CATALOGUE)
    rig = _mapping(plant.get("rig"), "rig in plant.yaml")
    return rows | _effect_rows("plant.rig.effects", rig.pop("effects", {}), RIG_EFFECTS)


@lru_cache(maxsize=1)
def _scenarios() -> dict[str, dict]:
    tree = _mapping(read_yaml(config_folder() / "scenario.yaml"), "scenario.yaml")
    scenarios = _mapping(tree.get("scenarios"), "scenarios in scenario.yaml")
    for name, entry in scenarios.items():
        where = f"scenario {name} in scenario.yaml"
        if not isinstance(_mapping(entry, where).get("meaning"), str):
            raise OrthosisError(f"{where} has no meaning")
        _mapping(entry.get("set") or {}, f"set of {where}")
    return scenarios


def _mapping(node: Any, where: str) -> dict[str, Any]:
    """Return a node of a file of config/ if it is a mapping of names."""
    if not isinstance(node, dict) or not all(isinstance(key, str) for key in node):
        raise OrthosisError(f"config/: {where} is not a mapping of names")
    return node


def _rows_of(tree: Mapping[str, Any], prefix: str) -> dict[str, Row]:
    rows: dict[str, Row] = {}
    for name, node in tree.items():
        key = f"{prefix}.{name}"
        if "value" in _mapping(node, key) and "meaning" in node:
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
    if not isinstance(node["value"], Value) or not isinstance(node["meaning"], str):
        raise OrthosisError(f"{key} in config/: value or meaning is of the wrong kind")


def _effect_rows(
    prefix: str, values: Mapping[str, Mapping[str, Any]], catalogue: Mapping[str, Any]
) -> dict[str, Row]:
    rows: dict[str, Row] = {}
    for effect in catalogue.values():
        for row in effect.rows(prefix):
            rows[row.key] = row
    for effect_name, settings in _mapping(values, prefix).items():
        for name, value in _mapping(settings, f"{prefix}.{effect_name}").items():
            key = f"{prefix}.{effect_name}.{name}"
            if key not in rows:
                raise _unknown(key, rows)
            rows[key] = rows[key].with_value(value)
    return rows


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
    close = difflib.get_close_matches(key, list(known), n=1, cutoff=0.5)
    hint = f"; did you mean {close[0]}?" if close else ""
    return OrthosisError(f"unknown parameter {key}{hint}")
