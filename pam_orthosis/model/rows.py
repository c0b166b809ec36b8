# SPDX-License-Identifier: Apache-2.0
"""A parameter as a row with unit, bounds, meaning and source; branches of them, read by attribute."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import shown

Value: TypeAlias = float | int | bool | str | list[float]


def rounded(values: Iterable[float], digits: int = 6) -> list[float]:
    """Return numbers with as many digits as a file of parameters has."""
    return [float(f"{value:.{digits}g}") for value in values]


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

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which values it may be."""
        low = -math.inf if self.minimum is None else self.minimum
        return low, math.inf if self.maximum is None else self.maximum

    def with_value(self, value: Any) -> Row:
        """Return the row with another value; OrthosisError for a wrong type, or what its limits forbid."""
        return replace(self, value=self._checked(value))

    def _checked(self, value: Any) -> Value:
        if isinstance(self.value, list):
            return self._checked_list(value, len(self.value))
        if isinstance(self.value, bool) or isinstance(value, bool):
            return bool(self._same_type(value, bool, "true or false"))
        if isinstance(self.value, str):
            return self._checked_choice(self._same_type(value, str, "a text"))
        return self._checked_number(value)

    def _checked_list(self, value: Any, length: int) -> list[float]:
        if not isinstance(value, list) or len(value) != length:
            raise OrthosisError(f"{self.key}: give a list of {length} numbers, not {shown(value)}")
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
    """A branch of the tree, read by attribute: `parameters.valve.hose.volume`."""

    def __init__(self, path: str, children: dict[str, Any]):
        self.__dict__.update(children)
        self._path = path

    def __getattr__(self, name: str) -> Any:
        raise MissingParameter(f"no parameter {self._path}.{name}: does its row stand in config/?")

    def __repr__(self) -> str:
        return "\n".join(
            f"{self._path}.{k}" + ("" if isinstance(v, Section) else f" = {v}") for k, v in self.items()
        )

    def items(self) -> Iterable[tuple[str, Any]]:
        """Pairs of name and value or branch."""
        return [(k, v) for k, v in self.__dict__.items() if not k.startswith("_")]


@dataclass(frozen=True)
class Field:
    """A parameter that a kind of component has: what a machine's file has to give, or may.

    `default` is its value where the file says nothing; None where it has to be given. `many`: a list.
    """

    name: str
    unit: str
    minimum: float
    maximum: float
    meaning: str
    default: float | None = None
    many: bool = False

    def row(self, prefix: str, value: Any, source: str) -> Row:
        """Return the row of a value that a file gives, checked; OrthosisError as `Row.with_value`."""
        of = [0.0] * (len(value) if isinstance(value, list) else 1) if self.many else 0.0
        row = Row(f"{prefix}.{self.name}", of, self.unit, self.minimum, self.maximum, self.meaning, source)
        return row.with_value(value)
