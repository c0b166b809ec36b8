# SPDX-License-Identifier: Apache-2.0
"""A muscle that is none of `config/`: its geometry from a user's file."""

from pathlib import Path
from typing import cast

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.identification.data import Bench
from pam_orthosis.model.parameters import load
from pam_orthosis.reading import check_keys, mapping, read_yaml

SECTION = "dmsp_20"  # of the knee's muscles, whatever muscle a user has
KEYS = ("length", "diameter", "fibre_angle", "wall")
NEEDED = KEYS[:2]


def own_bench(path: Path) -> Bench:
    """Return parameters in which the knee's muscle has the geometry of a file.

    The file gives `length` (nominal) and `diameter` in m, and may give `fibre_angle` in rad and `wall` in m.
    Until force and volume are identified, they are those of the DMSP-20 in proportion to the cross-section,
    the volume to the length too; it counts as given.

    Raises:
        OrthosisError: unreadable, another or a missing key, or a value that no muscle has.
    """
    given = mapping(read_yaml(path), str(path))
    check_keys(given, KEYS, f"{path}: a muscle")
    if missing := [key for key in NEEDED if key not in given]:
        raise OrthosisError(f"{path}: no {missing[0]}; give it in m")
    wall_share = 0.09  # of the diameter, as a DMSP-20's
    with naming(path):
        shipped = load().at(f"muscle.{SECTION}")
        geometry = _checked({f"geometry.{key}": value for key, value in given.items() if key != "length"})
        geometry.setdefault("geometry.wall", wall_share * geometry["geometry.diameter"])
        length = _checked({"map_length": given["length"]})["map_length"]
        share = (geometry["geometry.diameter"] / shipped.geometry.diameter) ** 2
        stretched = length / shipped.map_length
        changed = {
            **geometry,
            "length": length,
            "map_length": length,
            "geometry.map_length": length,
            "force.a": [share * a / stretched**i for i, a in enumerate(shipped.force.a)],
            "force.b": [share * b / stretched**i for i, b in enumerate(shipped.force.b)],
            "volume.v": [share * v * stretched ** (1 - i) for i, v in enumerate(shipped.volume.v)],
        }
        own = tuple(key for key in changed if not key.startswith("force."))
        return Bench(load({f"muscle.{SECTION}.{k}": v for k, v in changed.items()}), (SECTION,), own)


def _checked(values: dict[str, object]) -> dict[str, float]:
    """Return values as their rows take them."""
    parameters = load()
    rows = {key: parameters.row(f"muscle.{SECTION}.{key}").with_value(v) for key, v in values.items()}
    return {key: cast(float, row.value) for key, row in rows.items()}
