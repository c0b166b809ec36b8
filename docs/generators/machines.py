# SPDX-License-Identifier: Apache-2.0
"""The page of what a machine's file may hold, from the schema that checks it."""

from collections.abc import Iterable

from generators.markdown import WIDE, table, value
from pam_orthosis.model.device import FOLDER
from pam_orthosis.model.effects import KINDS
from pam_orthosis.model.machine import ACTUATORS
from pam_orthosis.model.machines import INLINE, MOST_ACTUATORS, OF_ACTUATOR, TOP
from pam_orthosis.model.mechanisms import MECHANISMS
from pam_orthosis.model.mechanisms.one_axis import TRANSMISSIONS
from pam_orthosis.model.parameters import load
from pam_orthosis.model.rows import Field, Section
from pam_orthosis.reading import config_folder

HEAD = """# Machine files

What the YAML file of a machine holds: [a machine of your own](../howto/machine.md) begins with one. SI units,
pressures absolute. Keys without a default have to be given. An unknown key
or a value out of its range is refused with one line.

"""
MEANINGS = {
    "name": ("of the joint in messages: letters, digits, hyphens, underscores", "the file's name"),
    "meaning": ("what it is, in reports", "the file's name"),
    "mechanism": ("its one coordinate and what moves with it, see below", ""),
    "actuators": (f"name: actuator, 1 to {MOST_ACTUATORS} of them, see below", ""),
    "sensor": ("of the coordinate: `noise` (standard deviation) and `resolution` (0), in its unit", ""),
    "values": ("parameters of `config/` that are others here, dotted keys or sections, see below", "none"),
    "effects": ("list of the kinds of effects that it may have", "all that fit"),
    "start": ("key of the coordinate at which it rests at first", "the mechanism's `start`"),
    "branch": ("of the parameters that switch effects on in the nominal model", "`effects`"),
    "coupled": ("`leg`: it is the knee or the ankle of a leg; see devices below", "none"),
    "experiments": ("whether the diagnostic scenarios are its own", "`false`"),
    "takes": ("key: key, the first has the value of the second", "none"),
}
OF_EACH = {
    "kind": ("one of {}", ""),
    "parameters": ("branch of parameters that it has: {}; a cylinder gives its own", ""),
    "transmission": ("how the coordinate contracts it, see below; a knee and a carriage have their own", ""),
    "parallel": (f"so many of them side by side on one valve, 1 to {MOST_ACTUATORS}", "1"),
    "sizes": ("effect: how many times larger than elsewhere it may be", "none"),
}
VALUES = """
## Values

Without `valve.delay`, the model has the dead time of the emulated hardware, the sum of `plant.delay`. Two
muscles of other sizes: one has `parameters: muscle.dmsp_10`, the other `muscle.dmsp_20`, and `values` gives
those of both. What `identify` writes may stand below `values: {muscle: ...}`.
"""
DEVICES = """
## Devices

A file with `joints` declares machines that run together, each with its own nodes in a namespace. A joint
has the `machine` that it is, `coupled` and `parallel` as above. `values` are those of all coupled joints,
`ankle/KEY` that of one; `sides` are namespaces around the joints, the second half a cycle ahead.

"""
TENSION = """
## Transmissions

An actuator of tension F acts on the coordinate q with F dL/dq. L is its contraction: the shortening of a
muscle, the stroke of a cylinder.
"""


def pages() -> dict[str, str]:
    """Return the page."""
    ways = (_section(f"By {way}", fields) for way, fields in TRANSMISSIONS.items())
    first = (WIDE, HEAD, _keys(MEANINGS, TOP), _mechanisms(), _actuators(), VALUES, TENSION)
    parts = (*first, *ways, _effects(), _shipped())
    return {"reference/machine-file.md": "".join(parts)}


def _keys(meanings: dict[str, tuple[str, str]], names: Iterable[str]) -> str:
    """Return a table of keys: each of the schema has a meaning."""
    return table(("key", "meaning", "default"), [(f"`{name}`", *meanings[name]) for name in names])


def _section(title: str, fields: Iterable[Field]) -> str:
    head = ("key", "meaning", "unit", "range", "default")
    rows = [
        (
            f"`{one.name}`", one.meaning, one.unit, f"{value(one.minimum)} .. {value(one.maximum)}",
            "" if one.default is None else value(one.default),
        )
        for one in fields
    ]  # fmt: skip
    return f"\n### {title}\n\n{table(head, rows)}"


def _mechanisms() -> str:
    own = {kind: one.fields for kind, one in MECHANISMS.items() if one.fields}
    shipped = " or ".join(f"`{kind}`" for kind in MECHANISMS if kind not in own)
    words = (
        f"\n## Mechanisms\n\n`kind` is {' or '.join(f'`{kind}`' for kind in own)}; the shipped machines are a"
        f" {shipped}, whose `parameters` are a branch of `config/`.\n"
    )
    return words + "".join(_section(kind, fields) for kind, fields in own.items())


def _actuators() -> str:
    muscles = (name for name, one in load().muscle.items() if isinstance(one, Section))
    said = {
        "kind": ", ".join(f"`{kind}`" for kind in ACTUATORS),
        "parameters": ", ".join(f"`muscle.{name}`" for name in muscles),
    }
    known = {key: (words.format(said.get(key, "")), other) for key, (words, other) in OF_EACH.items()}
    inline = (_section(kind, fields) for kind, fields in INLINE.items())
    return "\n## Actuators\n\n" + _keys(known, OF_ACTUATOR) + "".join(inline)


def _effects() -> str:
    words = (
        "\n## Effects\n\nA machine has an instance of each effect for what it has of that kind. Where it is"
        " of an actuator, its name begins with the actuator's: `push_leak`.\n\n"
    )
    rows = [(f"`{one.name.removeprefix('{actuator}_')}`", one.of, one.stage) for one in KINDS]
    return words + table(("effect", "of", "stage"), rows)


def _shipped() -> str:
    return "\n## The shipped machines\n\n" + _texts("machines") + DEVICES + _texts(FOLDER)


def _texts(folder: str) -> str:
    files = sorted((config_folder() / folder).glob("*.yaml"))
    return "\n".join(f"```yaml\n{file.read_text(encoding='utf-8').strip()}\n```\n" for file in files)
