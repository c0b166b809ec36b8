# SPDX-License-Identifier: Apache-2.0
"""Files and texts from outside: regular, of bounded size and depth, refused in one line that names them.

Bounds stand here and not in config/, which is read through them.
"""

import csv
import difflib
import io
import itertools
import json
import os
import re
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from pam_orthosis.errors import OrthosisError

COMMENT = "#"  # begins a line of a table that is left out
MOST_TEXT = 16 << 20  # bytes of a YAML or JSON text
MOST_TABLE = 64 << 20  # bytes of a CSV table: an hour of a joint at 200 Hz
MOST_LINE = 1 << 20  # characters of a line of a table
MOST_SCALAR = 100_000  # characters of a text or number in YAML
MOST_NODES = 100_000  # of a YAML text, each alias counted as what it stands for
MOST_DEPTH = 64  # of lists and mappings within each other
MOST_DIRECTIVES = 2  # of a YAML text
ROW = {"value", "meaning"}  # what a parameter's row has at least
SHOWN = 60  # characters of a value in a refusal
KINDS = {
    stat.S_ISDIR: "a folder",
    stat.S_ISFIFO: "a named pipe",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
}


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """A safe loader that takes no key twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; ConstructorError if a key is there twice."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if isinstance(key, yaml.ScalarNode) and (key.tag, key.value) in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{shown(key.value)} is there twice")
            seen.add((key.tag, key.value) if isinstance(key, yaml.ScalarNode) else id(key))
        return dict(super().construct_mapping(node, deep=deep))


# YAML 1.1 takes 8e-4 for a text, for want of a point
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+\Z"), list("-+0123456789")
)


def check_file(path: Path) -> None:
    """Refuse, by OrthosisError, what is no regular file: a pipe or a device may be read without end."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if not stat.S_ISREG(mode):
        kind = next((words for is_kind, words in KINDS.items() if is_kind(mode)), "no regular file")
        raise OrthosisError(f"{path} is {kind}; give a file")


def open_file(path: Path) -> BinaryIO:
    """Open a regular file to read its bytes; OrthosisError if it is none, or cannot be opened."""
    check_file(path)
    try:
        # what takes its place in between is opened without waiting for it, and refused
        stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except OSError as error:
        raise _unreadable(path, error) from error
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise OrthosisError(f"{path} is no regular file")
    return stream


def read_text(path: Path) -> str:
    """Return a text in UTF-8; OrthosisError if it is none, too long, or no regular file."""
    with open_file(path) as stream:
        try:
            data = stream.read(MOST_TEXT + 1)
        except OSError as error:
            raise _unreadable(path, error) from error
    if len(data) > MOST_TEXT:
        raise OrthosisError(f"{path} is longer than {MOST_TEXT >> 20} MiB: it is not the file that is meant")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _not_utf8(path, error) from error


def _not_utf8(path: Path, error: UnicodeDecodeError) -> OrthosisError:
    return OrthosisError(f"{path} is not UTF-8 (at byte {error.start}): save it as UTF-8")


def read_yaml(path: Path) -> Any:
    """Read a YAML file; OrthosisError if it is missing, malformed or beyond the bounds."""
    return from_yaml(read_text(path), str(path))


def from_yaml(text: str, name: str) -> Any:
    """Return what a YAML text holds.

    Raises:
        OrthosisError: it is malformed, too long, nested too deeply, or its aliases stand for too much; the
            message begins with `name`.
    """
    try:
        _check_bounds(text)
        return yaml.load(text, Loader=_Loader)
    except Exception as error:  # odd values make the constructors raise anything
        raise OrthosisError(f"{name} is not valid YAML: {_reason(error)}") from error


def from_json(text: str, name: str) -> Any:
    """Return what a JSON text holds; OrthosisError, naming it, as `from_yaml`."""
    try:
        if len(text) > MOST_TEXT:
            raise ValueError(f"longer than {MOST_TEXT >> 20} MiB")
        _check_depth(text)
        return json.loads(text, object_pairs_hook=_without_doubles)
    except ValueError as error:
        raise OrthosisError(f"{name} is not valid JSON: {_reason(error)}") from error


def csv_rows(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number and cells of each row of a CSV table, one after the other, and what parts cells.

    Commas, semicolons or tabs part its columns, as its row of names says.

    Raises:
        OrthosisError: no regular file, no text in UTF-8, too long, or no table.
    """
    with open_file(path) as stream:
        if os.fstat(stream.fileno()).st_size > MOST_TABLE:
            raise OrthosisError(f"{path} is longer than {MOST_TABLE >> 20} MiB; give parts of it, or a bag")
        lines = _lines(io.TextIOWrapper(stream, encoding="utf-8-sig", newline=""))
        try:
            begun = list(_up_to_names(lines))
            parting = next((one for one in "\t;" if begun and one in begun[-1]), ",")
            reader = csv.reader(itertools.chain(begun, lines), delimiter=parting)
            for row in reader:
                yield reader.line_num, row, parting
        except UnicodeDecodeError as error:
            raise _not_utf8(path, error) from error
        except csv.Error as error:
            raise OrthosisError(f"{path} is not a table of numbers with one row of names: {error}") from error


def _up_to_names(lines: Iterator[str]) -> Iterator[str]:
    for line in lines:
        yield line
        if line.strip(" ,;\t\r\n") and not line.lstrip(' "').startswith(COMMENT):
            return


def shown(value: Any) -> str:
    """Return a value as a refusal shows it: not longer than a few words."""
    try:
        text = repr(value)
    except ValueError:  # a whole number of thousands of digits
        return "a number beyond all bounds"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def _lines(stream: io.TextIOWrapper) -> Iterator[str]:
    while line := stream.readline(MOST_LINE):
        if len(line) == MOST_LINE and not line.endswith("\n"):
            raise csv.Error("a line is longer than a million characters")
        yield line


def _check_bounds(text: str) -> None:
    """Check a YAML text event by event: no recursion, and no alias is followed."""
    if len(text) > MOST_TEXT:
        raise ValueError(f"longer than {MOST_TEXT >> 20} MiB")
    if len(re.findall(r"^%", text, re.MULTILINE)) > MOST_DIRECTIVES:
        raise ValueError("too many directives")
    sizes: dict[str | None, int] = {}
    open_: list[tuple[str | None, int]] = []  # anchor of each collection, nodes before it
    nodes = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            _check_alias(event.anchor, [anchor for anchor, _ in open_])
            nodes += sizes.get(event.anchor, 1)
        elif isinstance(event, yaml.ScalarEvent):
            _check_scalar(event.value)
            nodes += 1
            sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            open_.append((event.anchor, nodes))
            nodes += 1
            if len(open_) > MOST_DEPTH:
                raise ValueError(f"nested more than {MOST_DEPTH} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_.pop()
            sizes[anchor] = nodes - before
        if nodes > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} values, aliases counted as what they stand for")


def _check_alias(anchor: str, around: Collection[str | None]) -> None:
    if anchor in around:
        raise ValueError(f"{shown(anchor)} holds itself")


def _check_scalar(value: str) -> None:
    if len(value) > MOST_SCALAR:
        raise ValueError(f"a text of more than {MOST_SCALAR} characters")


def _check_depth(text: str) -> None:
    """Check a JSON text bracket by bracket, those within texts left out."""
    depth = 0
    outside = "".join(text.replace("\\\\", "").replace('\\"', "").split('"')[::2])
    for bracket in re.finditer(r"[][{}]", outside):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > MOST_DEPTH:
            raise ValueError(f"nested more than {MOST_DEPTH} deep")


def _without_doubles(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise ValueError(f"{shown(key)} is there twice")
        result[key] = value
    return result


def _reason(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem:
        at = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        return f"{error.problem}{at}"
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def _unreadable(path: Path, error: OSError | ValueError) -> OrthosisError:
    return OrthosisError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}")


def config_folder() -> Path:
    """Return the folder of the shipped YAML files (installed package, or source tree)."""
    package = Path(__file__).resolve().parent
    installed = package / "config"
    return installed if installed.is_dir() else package.parent / "config"


def mapping(node: Any, where: str) -> dict[str, Any]:
    """Return a node of a file if it is a mapping of names; OrthosisError if it is not."""
    if not isinstance(node, dict) or not all(isinstance(key, str) for key in node):
        raise OrthosisError(f"{where} is not a mapping of names")
    return node


def flattened(node: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted key -> value of sections, dotted keys or rows; OrthosisError for a key given twice."""
    flat: dict[str, Any] = {}
    for key, value in _flat("", node):
        if key in flat:
            raise OrthosisError(f"{key} is there twice")
        flat[key] = value
    return flat


def _flat(prefix: str, node: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, dict) and value.keys() >= ROW:
            yield f"{prefix}{key}", value["value"]
        elif isinstance(value, dict):
            yield from _flat(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


def check_keys(given: Iterable[str], known: Collection[str], where: str) -> None:
    """Refuse, by OrthosisError, a key that is not known."""
    for key in given:
        if key not in known:
            raise OrthosisError(f"{where} has no {shown(key)}{meant(key, known)}; it has {', '.join(known)}")


def meant(key: str, known: Iterable[str]) -> str:
    """Return a question for the name that a wrong one is near to, or nothing."""
    there = list(known)
    ends = [one for one in there if one.endswith(f".{key}")]  # of a dotted key the end alone
    close = ends[:1] or difflib.get_close_matches(key, there, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""
