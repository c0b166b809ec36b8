# SPDX-License-Identifier: Apache-2.0
"""What a caller gives, checked where it comes in: a refusal names the argument and says what to give."""

import math
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import machine_named
from pam_orthosis.reading import shown as cut


def shown(value: object) -> str:
    """Return a value as a refusal shows it, in one line."""
    return " ".join(cut(value).split())


def number(value: object, name: str, least: float = 0.0, most: float = sys.float_info.max) -> float:
    """Return a number that is not below `least`; OrthosisError for anything else, NaN among it."""
    if (
        isinstance(value, int | float | np.integer | np.floating)
        and not isinstance(value, bool)
        and least <= value <= most
    ):
        return float(value)
    bounds = f", {least:g} or more" if math.isfinite(least) else ""
    raise OrthosisError(f"{name}: give a number{bounds}, not {shown(value)}")


def whole(value: object, name: str, least: int, most: int) -> int:
    """Return a whole number between two; OrthosisError for anything else."""
    given = number(value, name, least)
    if given != int(given) or given > most:
        raise OrthosisError(f"{name}: give a whole number, {least} to {most}, not {shown(value)}")
    return int(given)


def numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return an array of numbers; OrthosisError for texts, or rows of different lengths."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise OrthosisError(f"{name}: give an array of numbers, not {shown(values)}") from None


def text(value: object, name: str) -> str:
    """Return a text; OrthosisError for anything else."""
    if not isinstance(value, str):
        raise OrthosisError(f"{name}: give a text, not {shown(value)}")
    return value


def path(value: object, name: str) -> Path:
    """Return a path; OrthosisError for anything else, an empty text among it."""
    if not isinstance(value, str | os.PathLike) or value == "":
        raise OrthosisError(f"{name}: give a text or a path, not {shown(value)}")
    return Path(value)


def file(value: object, name: str) -> Path | None:
    """Return a path, or None where none is given; OrthosisError for anything else."""
    return None if value is None else path(value, name)


def columns(values: object) -> list[str]:
    """Return texts SIGNAL=COLUMN, from such texts or a mapping; OrthosisError for anything else."""
    if isinstance(values, Mapping):
        values = [f"{signal}={column}" for signal, column in values.items()]
    listed = [values] if isinstance(values, str) else values
    advice = "columns: give signals with their columns, such as {'time': 't:ms'}"
    return [text(one, "columns") for one in several(listed, advice)]


def changes(values: object, name: str) -> dict[str, Any]:
    """Return dotted key -> value; OrthosisError for anything else."""
    if not isinstance(values, Mapping):
        example = "{'control.position.c1': 30.0}"
        raise OrthosisError(f"{name}: give keys with their values, such as {example}, not {shown(values)}")
    return {text(key, f"a key of {name}"): value for key, value in values.items()}


def machine(value: object) -> Machine | None:
    """Return a machine, or that of a file; OrthosisError for anything else, or an unusable file."""
    return value if value is None or isinstance(value, Machine) else machine_named(path(value, "machine"))


def several(values: object, advice: str) -> list[Any]:
    """Return what is in a list; OrthosisError, with advice, for a path, whose letters are no files."""
    if not isinstance(values, Iterable) or isinstance(values, str | bytes | os.PathLike | Mapping):
        raise OrthosisError(advice)
    return list(values)
