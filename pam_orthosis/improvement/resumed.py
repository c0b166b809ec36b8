# SPDX-License-Identifier: Apache-2.0
"""What `improve` keeps in its folder so that the same command continues where it was cut short.

A state file says which command the folder belongs to. Bags and the findings of searches appear whole or not
at all: what is there is finished. All else follows from them.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pam_orthosis import __version__
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import refuse_existing, refuse_used, write_text
from pam_orthosis.reading import from_json, read_text

STATE, FOUND = "improve-state.json", "found.json"


@dataclass(frozen=True)
class Found:
    """What a search for the gap gave: effects, values of all parameters, verdict, all of it for a file."""

    effects: tuple[str, ...]
    values: Mapping[str, float]
    verdict: str
    told: Mapping[str, Any]


def digest(arguments: Mapping[str, Any]) -> str:
    """Return what distinguishes one command, of this version, from others."""
    text = json.dumps({**arguments, "version": __version__}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def begin(folder: Path, arguments: str, results: Iterable[str]) -> bool:
    """Mark a new or empty folder as that of a command, by the digest of its arguments; return if it was.

    Raises:
        OrthosisError: it holds something else, the work of other arguments, or finished results.
    """
    file, state = folder / STATE, {"verb": "improve", "arguments": arguments}
    if not file.exists():
        refuse_used(folder)
        write_text(file, json.dumps(state, indent=2) + "\n")
        return False
    there = from_json(read_text(file), str(file))
    if not isinstance(there, dict) or there.keys() != state.keys() or there["verb"] != state["verb"]:
        raise OrthosisError(f"{file} was not written by `improve`; choose another --out")
    if there != state:
        raise OrthosisError(
            f"{folder} was begun with other arguments, or by another version; repeat the command as it was,"
            " or choose another --out"
        )
    refuse_existing(folder / name for name in results)
    return True


def write_found(folder: Path, found: Found) -> None:
    """Store what a search found in the folder of its round."""
    write_text(folder / FOUND, json.dumps(asdict(found), indent=2) + "\n")


def read_found(folder: Path) -> Found | None:
    """Return what a round's search found, None if it goes on; OrthosisError if its file is neither."""
    file = folder / FOUND
    if not file.exists():
        return None
    try:
        saved = Found(**from_json(read_text(file), str(file)))
        values = {str(key): float(value) for key, value in saved.values.items()}
        return Found(tuple(map(str, saved.effects)), values, str(saved.verdict), dict(saved.told))
    except (TypeError, ValueError, AttributeError) as error:
        raise OrthosisError(f"{file} is no result of a search; choose another --out") from error
