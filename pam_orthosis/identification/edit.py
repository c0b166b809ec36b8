# SPDX-License-Identifier: Apache-2.0
"""Values put into a YAML text: what is not replaced keeps every character.

The places come from PyYAML's parser. A round trip through a loaded tree would write untouched numbers and
layout anew: ruamel.yaml changes the last digit of some.
"""

from __future__ import annotations

from collections.abc import Mapping

import yaml

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import from_yaml


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
    start, end = node.start_mark.index, node
    while isinstance(end, yaml.CollectionNode) and not end.flow_style:  # its mark is at what follows
        end = end.value[-1] if isinstance(end, yaml.SequenceNode) else end.value[-1][1]
    return start, end.end_mark.index
