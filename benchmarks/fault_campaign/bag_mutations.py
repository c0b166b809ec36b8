# SPDX-License-Identifier: Apache-2.0
"""Ways to spoil a bag: its bytes, its messages, its metadata. Each takes a generator and returns trials."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from fault_campaign import bags
from fault_campaign.trial import ANY, CANARY, JUDGED, REFUSED, Trial
from pam_orthosis.bag.topics import SECOND_NS

SMUGGLE = f'!!python/object/apply:os.system ["touch {CANARY}"]'
# what the tracking verdict needs
NEEDED = ("/joint_states", "/reference")
PERIOD_NS = 5_000_000


class Bags:
    """The bags that are spoilt: half a second of walking and a short procedure of the rig."""

    def __init__(self, folder: Path, walk: Path):
        self.source = walk
        self.walk = bags.content(walk, SECOND_NS // 2)
        self.file = bags.write(folder / "walk", self.walk)
        self.rig = bags.rig_bags(folder / "rig")


def byte_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, bags whose bytes are spoilt, for verbs that read bags."""
    while True:
        for name, spoil in BYTES.items():
            for verb in ("check", "recover", "report", "identify", "metadata"):
                yield _byte_trial(base, name, spoil, verb, int(rng.integers(2**32)))


def _byte_trial(base: Bags, name: str, spoil: Callable, verb: str, seed: int) -> Trial:
    def make(folder: Path) -> list:
        rng = np.random.default_rng(seed)
        source = base.rig[int(rng.integers(len(base.rig)))] if verb == "identify" else base.file
        bag = folder / "bag"
        shutil.copytree(source, bag)
        file = bag / "metadata.yaml" if verb == "metadata" else next(bag.glob("*.mcap"))
        file.write_bytes(spoil(bytearray(file.read_bytes()), rng))
        if verb == "identify":
            others = [other for other in base.rig if other != source]
            return [verb, bag, *others]
        if verb == "recover":
            (bag / "metadata.yaml").unlink()
        options = {"report": ["--out", folder / "out"], "recover": ["--out", folder / "out"]}
        return ["check" if verb == "metadata" else verb, bag, *options.get(verb, [])]

    what = f"{verb}: {name}, seed {seed}"
    return Trial("bag, bytes", what, make, names=("bag",))


def _truncated(data: bytearray, rng) -> bytes:
    return data[: int(rng.integers(len(data)))]


def _flipped(data: bytearray, rng) -> bytes:
    for place in rng.integers(len(data), size=int(rng.choice([1, 3, 30]))):
        data[place] ^= 1 << int(rng.integers(8))
    return data


def _overwritten(data: bytearray, rng) -> bytes:
    start, length = int(rng.integers(len(data))), int(rng.integers(1, 4000))
    value = int(rng.choice([0, 255, 127]))
    data[start : start + length] = bytes([value]) * len(data[start : start + length])
    return data


def _removed(data: bytearray, rng) -> bytes:
    start = int(rng.integers(len(data)))
    del data[start : start + int(rng.integers(1, 4000))]
    return data


def _repeated(data: bytearray, rng) -> bytes:
    start = int(rng.integers(len(data)))
    data[start:start] = data[start : start + int(rng.integers(1, 4000))]
    return data


def _noise(data: bytearray, rng) -> bytes:
    return rng.bytes(int(rng.integers(1, 5000)))


BYTES = {
    "truncated": _truncated,
    "bits flipped": _flipped,
    "overwritten": _overwritten,
    "bytes removed": _removed,
    "bytes repeated": _repeated,
    "nothing but noise": _noise,
}


def message_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, bags with spoilt messages or metadata, for `check` and `gap`."""
    while True:
        for name, (change, allowed) in MESSAGES.items():
            seed = int(rng.integers(2**32))
            yield Trial(
                "bag, messages", f"{name}, seed {seed}", _changed(base, change, seed), allowed, ("bag",)
            )
        for name, change in METADATA.items():
            yield Trial("bag, metadata", name, _with_metadata(base, change), *METADATA_ALLOWED.get(name, ()))
        for name, run in RUNS.items():
            for verb in ("check", "gap", "report"):
                yield Trial("bag, metadata", f"{verb}: {name}", _with_run(base, run, verb), ANY)


def _changed(base: Bags, change: Callable, seed: int) -> Callable:
    def make(folder: Path) -> list:
        held = change(base.walk, np.random.default_rng(seed))
        if isinstance(held, bags.Content):
            bags.write(folder / "bag", held)
        else:
            bags.write(folder / "bag", *held)
        return ["check", folder / "bag"]

    return make


def _one(held: bags.Content, rng, topics=NEEDED) -> int:
    return int(rng.choice(bags.of_topic(held, str(rng.choice(topics)))))


def _with_value(value: float) -> Callable:
    def change(held, rng):
        entries, place = list(held.entries), _one(held, rng)
        entries[place] = bags.valued(entries[place], value)
        return held._replace(entries=entries)

    return change


def _whole_topic(factor: float) -> Callable:
    """Return a change that gives the angle and its reference in another unit."""

    def change(held, rng):
        entries = [
            bags.valued(e, factor * e.message.position[0]) if e.topic == "/joint_states" else e
            for e in held.entries
        ]
        return held._replace(entries=entries)

    return change


def _without(topic: str) -> Callable:
    return lambda held, rng: held._replace(entries=[e for e in held.entries if e.topic != topic])


def _renamed(held, rng):
    entries = [e._replace(topic=f"{e.topic}_") if e.topic in NEEDED else e for e in held.entries]
    return held._replace(entries=entries)


def _wrong_type(held, rng):
    """The angle's topic with messages of a pressure."""
    pressure = held.entries[bags.of_topic(held, "/extensor/pressure")[0]]
    entries = [
        bags.stamped(pressure, e.stamp_ns)._replace(topic=e.topic) if e.topic == "/joint_states" else e
        for e in held.entries
    ]
    return held._replace(entries=entries)


def _shuffled(held, rng):
    return held._replace(entries=[held.entries[place] for place in rng.permutation(len(held.entries))])


def _moved(by_ns: Callable) -> Callable:
    def change(held, rng):
        return held._replace(entries=[bags.stamped(e, by_ns(e.stamp_ns, rng)) for e in held.entries])

    return change


def _thinned(held, rng):
    every = int(rng.integers(2, 12)) * PERIOD_NS
    return held._replace(entries=[e for e in held.entries if e.stamp_ns % every == 0])


def _gap(held, rng):
    start = int(rng.integers(SECOND_NS // 4))
    return held._replace(entries=[e for e in held.entries if not start < e.stamp_ns < start + SECOND_NS // 8])


def _doubled(held, rng):
    return held._replace(entries=[twice for e in held.entries for twice in (e, e)])


def _first(count: int) -> Callable:
    return lambda held, rng: held._replace(
        entries=[e for e in held.entries if e.stamp_ns < count * PERIOD_NS]
    )


def _disjoint(held, rng):
    move = {"/reference": 10 * SECOND_NS}
    return held._replace(entries=[bags.stamped(e, e.stamp_ns + move.get(e.topic, 0)) for e in held.entries])


def _no_joint(held, rng):
    entries = [bags.stamped(e, e.stamp_ns) if e.topic == "/joint_states" else e for e in held.entries]
    for entry in entries:
        if entry.topic == "/joint_states":
            entry.message.name = [str(rng.choice(["", "hip", "knee\n\u202eeenk", "k" * 2000]))]
    return held._replace(entries=entries)


def _cut_messages(held, rng):
    keep = float(rng.uniform(0.0, 1.0))
    return held, lambda entry, data: data[: int(keep * len(data))] if entry.topic in NEEDED else data


def _noisy_messages(held, rng):
    return held, lambda entry, data: rng.bytes(len(data)) if entry.topic in NEEDED else data


def _long_sequences(held, rng):
    """Say in a message that a list of 4 thousand million numbers follows."""

    def raw(entry, data):
        place = 12 if entry.topic == "/joint_states" else 0
        return data[:place] + b"\xff" * 8 + data[place + 8 :] if place else data

    return held, raw


MESSAGES = {
    "one value is NaN": (_with_value(math.nan), REFUSED),
    "one value is infinite": (_with_value(math.inf), REFUSED),
    "one value is -1e300": (_with_value(-1e300), REFUSED),
    "angles in degrees": (_whole_topic(180 / math.pi * 100), REFUSED),
    "no angle": (_without("/joint_states"), REFUSED),
    "no reference": (_without("/reference"), REFUSED),
    "no voltages": (_without("/extensor/valve_command"), JUDGED),
    "no messages at all": (_first(0), REFUSED),
    "one instant": (_first(1), ANY),
    "two instants": (_first(2), JUDGED),
    "topics renamed": (_renamed, REFUSED),
    "another type on a topic": (_wrong_type, REFUSED),
    "messages out of order": (_shuffled, JUDGED),
    "stamps out of order": (_moved(lambda t, rng: t + PERIOD_NS * int(rng.integers(-3, 4))), ANY),
    "all stamps equal": (_moved(lambda t, rng: 0), ANY),
    "stamps before 1970": (_moved(lambda t, rng: t - 5 * SECOND_NS), ANY),
    "stamps in the far future": (_moved(lambda t, rng: t + 2_000_000_000 * SECOND_NS), ANY),
    "stamps run backwards": (_moved(lambda t, rng: 10 * SECOND_NS - t), ANY),
    "another rate": (_thinned, JUDGED),
    "a gap": (_gap, JUDGED),
    "every message twice": (_doubled, JUDGED),
    "angle and reference never at once": (_disjoint, REFUSED),
    "another joint": (_no_joint, REFUSED),
    "messages cut short": (_cut_messages, ANY),
    "messages of noise": (_noisy_messages, ANY),
    "lists longer than the message": (_long_sequences, REFUSED),
}


def _with_metadata(base: Bags, text: Callable[[str], str | bytes | None]) -> Callable:
    def make(folder: Path) -> list:
        shutil.copytree(base.file, folder / "bag")
        file = folder / "bag" / "metadata.yaml"
        changed = text(file.read_text())
        if changed is None:
            file.unlink()
        else:
            file.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
        return ["check", folder / "bag"]

    return make


METADATA = {
    "no metadata.yaml": lambda text: None,
    "empty metadata.yaml": lambda text: "",
    "metadata.yaml is a list": lambda text: "- 1\n- 2\n",
    "metadata.yaml with a program in it": lambda text: text + f"x: {SMUGGLE}\n",
    "nothing but a program": lambda text: SMUGGLE,
    "bytes that are no text": lambda text: b"\xff\xfe\x00" * 40,
    "another file": lambda text: text.replace("walk_0.mcap", "../../../../../../etc/hostname"),
    "a missing file": lambda text: text.replace("walk_0.mcap", "walk_1.mcap"),
    "counts are wrong": lambda text: text.replace("message_count: 1", "message_count: 7"),
    "an unknown version": lambda text: text.replace("version: 9", "version: 99"),
    "an unknown compression": lambda text: text.replace("compression_format: ''", "compression_format: lzma"),
    "an unknown storage": lambda text: text.replace("identifier: mcap", "identifier: tape"),
    "endless aliases": lambda text: "a: &a [x, x]\n" + "".join(
        f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
        for a, b in zip("abcdefghijk", "bcdefghijkl", strict=True)
    ),
    "tabs": lambda text: text.replace("  ", "\t"),
    "deeply nested": lambda text: "[" * 3000,
}  # fmt: skip
_NAMED = (REFUSED, ("bag",))
METADATA_ALLOWED = dict.fromkeys(
    (name for name in METADATA if name not in ("counts are wrong", "an unknown compression")), _NAMED
)


def _with_run(base: Bags, run: Callable[[dict], dict], verb: str) -> Callable:
    def make(folder: Path) -> list:
        bags.write(folder / "bag", base.walk._replace(run=run(dict(base.walk.run))))
        if verb == "gap":  # the second recording is missing: the search itself is not what is tried
            return ["gap", folder / "bag", folder / "missing"]
        return [verb, folder / "bag", *(["--out", folder / "out"] if verb == "report" else [])]

    return make


def _parameter(key: str, value: object) -> Callable[[dict], dict]:
    return lambda run: run | {"parameters": json.dumps(json.loads(run["parameters"]) | {key: value})}


RUNS = {
    "parameters that are no JSON": lambda run: run | {"parameters": "{'a': 1"},
    "parameters that are a list": lambda run: run | {"parameters": "[1, 2]"},
    "parameters that are a number": lambda run: run | {"parameters": "7"},
    "no parameters": lambda run: {"scenario": "x"},
    "nested too deeply": lambda run: run | {"parameters": "[" * 100_000},
    "an unknown parameter": _parameter("leg.tail.length", 1.0),
    "a parameter of the wrong type": _parameter("scenario.cycle_time", "two"),
    "a parameter that is a list": _parameter("scenario.start_hold", [1]),
    "a parameter that is null": _parameter("leg.shank.length", None),
    "a parameter that is NaN": _parameter("scenario.start_hold", math.nan),
    "a cycle time of zero": _parameter("scenario.cycle_time", 0),
    "a negative cycle time": _parameter("scenario.cycle_time", -1.0),
    "a number beyond all bounds": _parameter("scenario.cycle_time", 1e-300),
}
