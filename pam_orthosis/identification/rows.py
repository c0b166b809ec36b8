# SPDX-License-Identifier: Apache-2.0
"""Identified parameters as rows of `config/muscle.yaml`, on their own or put into such a file.

In a file what is not replaced keeps every character. The places come from PyYAML's parser: a round trip
through a loaded tree would write untouched numbers anew, and ruamel.yaml changes the last digit of some.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.identify import Identified
from pam_orthosis.identification.kept import VOLUME
from pam_orthosis.model.rows import Row
from pam_orthosis.reading import from_yaml, read_text

OF_FILE = ("geometry.", "length")
# the lowest pressure is no finding: the force is linear in the pressure
MEASURED_ENDS = ("minimum_contraction", "maximum_contraction", "maximum_pressure_gauge")


def values(found: Identified) -> dict[str, Any]:
    """Return key below the muscle's section -> value, for all that was identified."""
    model, box = found.force.model, found.box
    polynomial_a, polynomial_b = 4, 5  # coefficients of Eq. (14)
    result: dict[str, Any] = {
        **{key: found.data.parameters.at(f"muscle.{found.data.specimen}.{key}") for key in found.data.own},
        "map_length": found.data.length,
        "force.a": _padded(model.a, polynomial_a),
        "force.b": _padded(model.b, polynomial_b),
        **{f"box.{name}": _rounded(getattr(box, name)) for name in MEASURED_ENDS},
    }
    if found.given_damping is not None:
        result["force.damping"] = _rounded(found.given_damping)
    elif found.damping:
        # controllers need all losses, dry friction counted in: D as Eq. (18) of the paper gives it
        result["force.damping"] = _rounded(found.damping.decrement, 4)
    if found.volume:
        result["volume.v"] = _padded(found.volume.v, len(found.volume.v))
        result["volume.w"] = _padded(found.volume.w, len(found.volume.w))
    return result


def check(found: Identified) -> None:
    """Refuse what was identified if no muscle can be so: the data are in another unit, then.

    Raises:
        OrthosisError: a value leaves its bounds or contradicts the muscle's geometry.
    """
    try:
        found.data.parameters.changed(
            {f"muscle.{found.data.specimen}.{key}": value for key, value in values(found).items()}
        )
    except OrthosisError as error:
        raise OrthosisError(
            f"the data give no possible muscle; check their units, or give its geometry by"
            f" --muscle FILE: {error}"
        ) from None


def as_yaml(found: Identified, source: str) -> str:
    """Return the rows as YAML in the layout of `config/muscle.yaml`, checked against its bounds."""
    parameters = found.data.parameters
    tree: dict[str, Any] = {}
    for key, value in values(found).items():
        row = parameters.row(f"muscle.{found.data.specimen}.{key}").with_value(value)
        *path, leaf = key.split(".")
        node = tree
        for step in path:
            node = node.setdefault(step, {})
        node[leaf] = _fields(row, _source(found, key, source))
    return str(yaml.safe_dump({found.data.specimen: tree}, sort_keys=False, width=1000))


def updated(file: Path, found: Identified, source: str) -> str:
    """Return a file laid out as `config/muscle.yaml` with these values and source; all else in it stays.

    Raises:
        OrthosisError: the file cannot be read or has not all of the rows.
    """
    parameters = found.data.parameters
    muscle = found.data.specimen
    fields: dict[str, str] = {}
    for key, value in values(found).items():
        parameters.row(f"muscle.{muscle}.{key}").with_value(value)
        origin = json.dumps(_source(found, key, source))
        fields |= {f"{muscle}.{key}.value": _text(value), f"{muscle}.{key}.source": origin}
    return replaced(read_text(file), fields, str(file))


def _source(found: Identified, key: str, source: str) -> str:
    """Return where a value comes from: what a muscle's own file gives, or scales, is not identified."""
    if key in found.data.own and key.startswith(OF_FILE):
        return "the muscle's own file (a wall that it does not give: in proportion to the diameter)"
    if key != VOLUME or found.volume:
        return source
    return f"that of {found.data.specimen} in proportion to length and cross-section"


def _fields(row: Row, source: str) -> dict[str, Any]:
    bounds = {"min": row.minimum, "max": row.maximum}
    given = {name: bound for name, bound in bounds.items() if bound is not None}
    return {"value": row.value, "unit": row.unit, **given, "meaning": row.meaning, "source": source}


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_text(item) for item in value)}]"
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _rounded(value: float, digits: int = 9) -> float:
    return float(f"{value:.{digits}g}")


def _padded(coefficients: Iterable[float], count: int) -> list[float]:
    """Return coefficients with nine digits; a lower degree than Eq. (14)'s leaves zeros."""
    found = [_rounded(c) for c in coefficients]
    return found + [0.0] * (count - len(found))


def replaced(text: str, values: Mapping[str, str], name: str) -> str:
    """Return a YAML text with other values at dotted keys, given as YAML of one line.

    Raises:
        OrthosisError: it is no YAML, has aliases, or has nothing at a key; the message begins with `name`.
    """
    from_yaml(text, name)  # refuses what is no YAML, or beyond the bounds
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text)):
        raise OrthosisError(f"{name} has aliases (*name): a value may belong to several rows; write them out")
    root = yaml.compose(text)
    places = [(*_place(root, key, name), value) for key, value in values.items()]
    for start, end, value in sorted(places, reverse=True):
        after = text[start + len(text[start:end].rstrip()) :]  # white space behind a block is not its own
        text = f"{text[:start]}{value}{after}"
    return text


def _place(root: yaml.Node | None, key: str, name: str) -> tuple[int, int]:
    """Return where the value of a dotted key begins and ends."""
    node = root
    for step in key.split("."):
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        node = next((value for at, value in pairs if at.value == step), None)
        if node is None or node.start_mark.index == node.end_mark.index:
            raise OrthosisError(f"{name} has no {key}; give a file laid out as config/muscle.yaml")
    assert node is not None  # a key has one step at least
    start, end = node.start_mark.index, node
    while isinstance(end, yaml.CollectionNode) and not end.flow_style:  # its mark is at what follows
        end = end.value[-1] if isinstance(end, yaml.SequenceNode) else end.value[-1][1]
    return start, end.end_mark.index
