# SPDX-License-Identifier: Apache-2.0
"""Serialised messages (CDR) without making objects of them: where their numbers lie, and what is padding.

Messages of one topic mostly have one shape: the same lengths of texts and lists, so that each number has its
place. A shape is found by walking through a message once; whether it is that of another one is seen by its
lengths. Layout after the OMG's CDR, version 1: each number lies at a multiple of its size behind the four
bytes of encapsulation; a text has its length with the zero at its end, a list its number of elements.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from pam_orthosis.bag.definitions import FIELDS
from pam_orthosis.bag.topics import SECOND_NS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

NOTHING = float("nan")  # in place of a number that is missing in a message
LITTLE_ENDIAN = b"\0\1"
STAMP, BIG_ENDIAN_STAMP = struct.Struct("<iI"), struct.Struct(">iI")
HEAD = 4
_FORMATS = {
    "bool": "?", "byte": "B", "uint8": "B", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip


class Unreadable(ValueError):
    """A serialised message that is not one of its type."""


@lru_cache
def store() -> Typestore:
    """Return the standard types of ROS 2 Jazzy."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


class Shape:
    """Places of a message's numbers.

    Attributes:
        size: of the message without what may trail it, bytes.
        places: path of a number (`header.stamp.sec`, `position[0]`) -> offset in the message, struct format.
        names: texts that are elements of a list (of joints) -> their places in it.
        takers: paths of some numbers -> what takes stamp and these out of such a message.
        lengths, found: a message of the same size, as one little-endian number, has this shape if the former
            mask, of lengths and names, leaves the latter of it.
    """

    def __init__(self, data: bytes, msgtype: str, most_trailing: int = 3):
        walk = _Walk(data, msgtype)
        if not 0 <= len(data) - HEAD - walk.position <= most_trailing:
            raise Unreadable(f"{msgtype} has another size")
        self.size = HEAD + walk.position
        self.places, self.names = walk.places, walk.names
        self.takers: dict[tuple[str, ...], Callable[[bytes], tuple[Any, ...]]] = {}
        self._kept = _mask([(0, 2), *walk.texts, *walk.lengths, *_spans(walk.places)])
        self.lengths = _mask([(0, 2), *walk.lengths, *walk.listed])
        self.found = int.from_bytes(data, "little") & self.lengths

    def path(self, field: str) -> str:
        """Return the path of a number of which a list's place may be given by a name: `position['knee']`."""
        for name, place in self.names.items():
            if field.endswith(there := f"['{name}']"):
                return f"{field.removesuffix(there)}[{place}]"
        return field

    def canonical(self, number: int) -> bytes:
        """Return such a message with zeros for padding."""
        return (number & self._kept).to_bytes(self.size, "little")


class Shapes:
    """The shapes of one type by size of the message, the last few of each."""

    def __init__(self, msgtype: str):
        self._msgtype = msgtype
        self._known: dict[int, list[Shape]] = defaultdict(list)

    def of(self, data: bytes, number: int) -> Shape:
        """Return the shape of a message, which is also given as one number; Unreadable if it has none."""
        known = self._known[len(data)]
        for shape in known:
            if number & shape.lengths == shape.found:  # no method: it would be called for each message
                return shape
        known.append(Shape(data, self._msgtype))
        del known[:-8]
        return known[-1]


class Reader:
    """Takes the stamp with which a message begins, and some of its numbers, out of serialised messages.

    `fields`: paths of the numbers, in lists by place or name; `?` behind one that may be missing.
    """

    def __init__(self, msgtype: str, fields: Sequence[str]):
        self._msgtype = msgtype
        self._fields = tuple(fields)
        self._shapes = Shapes(msgtype)

    def __call__(self, data: bytes) -> tuple[int, tuple[float, ...]]:
        """Return the stamp in ns and the numbers: NaN for one that is not there, None if it may be missing.

        Unreadable if it is no message of the type.
        """
        if data[:2] != LITTLE_ENDIAN:
            data = _rewritten(data, self._msgtype)
        shape = self._shapes.of(data, int.from_bytes(data, "little"))
        take = shape.takers.get(self._fields)
        if take is None:
            take = shape.takers[self._fields] = _taker(shape, self._fields)
        values = take(data)
        return values[0] * SECOND_NS + values[1], values[2:]

    def stamp_ns(self, data: bytes) -> int:
        """Return the stamp alone, ns, whatever stands behind it; Unreadable if there is none."""
        if data[:2] != LITTLE_ENDIAN:
            return self(data)[0]
        if len(data) < HEAD + STAMP.size:
            raise Unreadable(f"{self._msgtype} has no stamp")
        return serialised_stamp_ns(data)


class Template:
    """Makes serialised messages of the shape of an example, with another stamp and other numbers.

    The example's first numbers are a stamp. `fields`: paths of the `count` numbers that differ, in the order
    of the message; none: all of type float64.
    """

    def __init__(self, example: bytes, msgtype: str, fields: Sequence[str] = ()):
        shape = Shape(example, msgtype, most_trailing=32)  # behind what rclpy serialises
        data = shape.canonical(int.from_bytes(example, "little"))
        places = list(shape.places.values())
        numbers = [shape.places[field] for field in fields] or [one for one in places if one[1] == "d"]
        self.count = len(numbers)
        self._message, self._runs = bytearray(data), _runs([*places[:2], *numbers])

    def __call__(self, stamp_ns: int, *numbers: float) -> bytes:
        """Return the message: stamp, and its `count` numbers in the order of the message."""
        if len(numbers) != self.count:
            raise ValueError(f"{len(numbers)} numbers to pack where a message has {self.count}")
        message, values = self._message, (*divmod(stamp_ns, SECOND_NS), *numbers)
        for pack, offset, first, last in self._runs:
            pack(message, offset, *values[first:last])
        return bytes(message)


def serialised_stamp_ns(data: bytes) -> int:
    """Return the stamp with which a serialised message begins, behind the encapsulation's four bytes."""
    seconds: int
    nanosec: int
    seconds, nanosec = (STAMP if data[1] & 1 else BIG_ENDIAN_STAMP).unpack_from(data, HEAD)
    return seconds * SECOND_NS + nanosec


def canonical(data: bytes, msgtype: str) -> bytes:
    """Return a serialised message with zeros for padding: DDS leaves there what memory held."""
    try:
        if data[:2] != LITTLE_ENDIAN:
            return _rewritten(data, msgtype)
        number = int.from_bytes(data, "little")
        return _shapes(msgtype).of(data, number).canonical(number)
    except Unreadable:  # more than padding trails it, or it is broken: keep what came
        return bytes(data)


def split(data: bytes, msgtype: str) -> tuple[bytes, dict[str, float]]:
    """Return a canonical message with zeros for its float64 numbers, and these; Unreadable if broken."""
    shape = _shapes(msgtype).of(data, int.from_bytes(data, "little"))
    rest, numbers = bytearray(data), {}
    for path, (offset, kind) in shape.places.items():
        if kind == "d":
            (numbers[path],) = struct.unpack_from("<d", data, offset)
            rest[offset : offset + 8] = bytes(8)
    return bytes(rest), numbers


@lru_cache
def _shapes(msgtype: str) -> Shapes:
    return Shapes(msgtype)


def _rewritten(data: bytes, msgtype: str) -> bytes:
    """Return a message in the byte order in which all others are."""
    from rosbags.serde import SerdeError

    try:
        return bytes(store().serialize_cdr(store().deserialize_cdr(data, msgtype), msgtype))
    except SerdeError as error:
        raise Unreadable(str(error)) from error


def _runs(numbers: Sequence[tuple[int, str]]) -> list[tuple[Callable[..., None], int, int, int]]:
    """Return what packs each run of adjoining numbers, its offset, and which of them it has: from, to."""
    runs, first = [], 0
    for index, (offset, kind) in enumerate(numbers, 1):
        if index == len(numbers) or numbers[index][0] != offset + struct.calcsize(kind):
            kinds = "".join(each for _, each in numbers[first:index])
            runs.append((struct.Struct(f"<{kinds}").pack_into, numbers[first][0], first, index))
            first = index
    return runs


def _taker(shape: Shape, fields: Sequence[str]) -> Callable[[bytes], tuple[Any, ...]]:
    """Return what takes the stamp and these numbers, and what stands for those that are not there."""
    names = [shape.path(field.rstrip("?")) for field in fields]
    there = sorted((*shape.places[name], name) for name in {*names} & {*shape.places})
    formats, at = f"<{HEAD}xiI", HEAD + STAMP.size
    for offset, kind, _ in there:
        formats += f"{offset - at}x{kind}"
        at = offset + struct.calcsize(kind)
    order = {name: index for index, (_, _, name) in enumerate(there, start=2)}
    picked = [order.get(name, -2 if "?" in field else -1) for field, name in zip(fields, names, strict=True)]
    unpack = struct.Struct(formats).unpack_from
    if picked == list(range(2, 2 + len(there))):
        return unpack
    pick = itemgetter(0, 1, *picked)
    return lambda data: pick((*unpack(data), None, NOTHING))


class _Walk:
    """A walk through a message: spans of its texts and lengths, places of its numbers and names."""

    def __init__(self, data: bytes, msgtype: str):
        self._data = data
        self.position = 0
        self.places: dict[str, tuple[int, str]] = {}
        self.texts: list[tuple[int, int]] = []
        self.lengths: list[tuple[int, int]] = []
        self.listed: list[tuple[int, int]] = []
        self.names: dict[str, int] = {}
        try:
            self._message(msgtype, "")
        except struct.error as error:
            raise Unreadable(f"{msgtype} ends too early") from error
        except KeyError as error:
            raise Unreadable(f"{msgtype} is not known") from error

    def _message(self, msgtype: str, path: str) -> None:
        for kind, name in _fields(msgtype):
            self._field(kind, f"{path}{name}")

    def _field(self, kind: str, path: str) -> None:
        if kind.endswith("[]"):
            for index in range(self._length()):
                self._field(kind[:-2], f"{path}[{index}]")
                if kind == "string[]":
                    self._name(index)
        elif kind == "string":
            self._text(path)
        elif kind in _FORMATS:
            self._number(_FORMATS[kind], path)
        else:
            self._message(kind, f"{path}.")

    def _text(self, path: str) -> None:
        size = self._length()
        self.texts.append((HEAD + self.position, size))
        self.position += size
        if HEAD + self.position > len(self._data):
            raise Unreadable(f"{path} is longer than its message")

    def _name(self, index: int) -> None:
        offset, size = self.texts[-1]
        self.listed.append((offset, size))
        text = bytes(self._data[offset : offset + size]).removesuffix(b"\0")
        self.names.setdefault(text.decode(errors="replace"), index)

    def _number(self, kind: str, path: str) -> None:
        size = struct.calcsize(kind)
        self.position = (self.position + size - 1) // size * size
        struct.unpack_from(f"<{kind}", self._data, HEAD + self.position)
        self.places[path] = HEAD + self.position, kind
        self.position += size

    def _length(self) -> int:
        length: int
        self.position = (self.position + 3) // 4 * 4
        (length,) = struct.unpack_from("<I", self._data, HEAD + self.position)
        self.lengths.append((HEAD + self.position, 4))
        self.position += 4
        return length


@lru_cache
def _fields(msgtype: str) -> list[list[str]]:
    return [field.split() for field in FIELDS[msgtype].split(",")]


def _spans(places: dict[str, tuple[int, str]]) -> list[tuple[int, int]]:
    return [(offset, struct.calcsize(kind)) for offset, kind in places.values()]


def _mask(spans: Sequence[tuple[int, int]]) -> int:
    """Return the number, little-endian, in which the bits of these (offset, size) are set."""
    mask = 0
    for offset, size in spans:
        mask |= ((1 << 8 * size) - 1) << 8 * offset
    return mask
