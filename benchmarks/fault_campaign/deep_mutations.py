# SPDX-License-Identifier: Apache-2.0
"""Spoilt input for verbs that go far with it: base files with which each of them would end well.

What a base file is used for is kept short: a search stops after its first stage, a replay feeds no node, a
run finds its folder used.
"""

from __future__ import annotations

import itertools
import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from fault_campaign import bags
from fault_campaign.bag_mutations import BYTES, MESSAGES, METADATA, RUNS, Bags
from fault_campaign.text_mutations import MODEL, MODELS, TABLES, WEIRD, rig_table, walk_table
from fault_campaign.trial import Trial
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.model.parameters import config_folder

ALLOWED = (0, 1, 2, 3)  # of a batch one bag may fail
BY_NAME = ("data", "dmsp20", "out")  # a run with a good model finds its folder used
SEARCHED_NS = 6 * SECOND_NS
STUDY = {
    "scenario": "person",
    "set": {"scenario.duration": 0.1},
    "seeds": [1],
    "grid": {"leg.person.mass": [70.0]},
}
RIG_OPTIONS = ("--muscle", "dmsp_20", "--held-out-bar", "--damping", "240", "--nominal-length-m")


def read_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, spoilt texts for verbs that read models, studies and rows."""
    texts = {
        "model": MODEL,
        "study": json.dumps(STUDY),
        "rows": (config_folder() / "muscle.yaml").read_text(),
    }
    spoilt = [(text[:30], lambda _, text=text: text.encode()) for text in (*WEIRD, *MODELS)]
    while True:
        for number in range(len(spoilt)):
            for name, spoil in BYTES.items():
                for verb, kind in (
                    ("plan", "model"),
                    ("run", "model"),
                    ("batch", "study"),
                    ("identify", "rows"),
                ):
                    data = bytes(spoil(bytearray(texts[kind].encode()), rng))
                    yield _text_trial(base, verb, name, data)
                    what, whole = spoilt[number]
                    yield _text_trial(base, verb, what, whole(None))


def _text_trial(base: Bags, verb: str, what: str, data: bytes) -> Trial:
    make, updated = _with_text(base, verb, data), "data.yaml" if verb == "identify" else ""
    return Trial("text, deep", f"{verb}: {what}", make, ALLOWED, BY_NAME, updated=updated)


def _with_text(base: Bags, verb: str, data: bytes) -> Callable:
    def make(folder: Path) -> list:
        (folder / "data.yaml").write_bytes(data)
        out = folder / "out"
        if verb == "run":
            out.mkdir()
            (out / "mine.txt").write_text("kept")
        if verb == "identify":
            (folder / "dmsp20.csv").write_text(rig_table())
            return [verb, folder / "dmsp20.csv", *RIG_OPTIONS, "0.3", "--update", folder / "data.yaml"]
        words = {"plan": ["--model"], "run": ["--model"], "batch": ["study"]}[verb]
        return [verb, *words, folder / "data.yaml", "--out", out]

    return make


def bag_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, bags whose bytes or messages are spoilt, for all verbs that read one."""
    searched = bags.content(base.source, SEARCHED_NS)
    for spoil_name in itertools.cycle(BYTES):
        for verb in READERS:
            make = _with_bytes(base, verb, BYTES[spoil_name], int(rng.integers(2**32)))
            yield Trial("bag, deep", f"{verb}: {spoil_name}", make, ALLOWED, ("data",))
            name = str(rng.choice(list(MESSAGES)))
            held = searched if verb == "gap" else base.walk
            make = _with_messages(base, verb, held, MESSAGES[name][0], int(rng.integers(2**32)))
            yield Trial("bag, deep", f"{verb}: {name}", make, ALLOWED, ("data",))


def _with_bytes(base: Bags, verb: str, spoil: Callable, seed: int) -> Callable:
    def make(folder: Path) -> list:
        shutil.copytree(base.source if verb in ("gap", "plan") else base.file, folder / "data")
        file = next((folder / "data").glob("*.mcap"))
        file.write_bytes(spoil(bytearray(file.read_bytes()), np.random.default_rng(seed)))
        return READERS[verb](base, folder)

    return make


def _with_messages(base: Bags, verb: str, held: bags.Content, change: Callable, seed: int) -> Callable:
    def make(folder: Path) -> list:
        changed = change(held, np.random.default_rng(seed))
        bags.write(folder / "data", *([changed] if isinstance(changed, bags.Content) else changed))
        return READERS[verb](base, folder)

    return make


def metadata_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, bags with spoilt metadata, for all verbs that read one."""
    while True:
        for name, text in METADATA.items():
            verb = str(rng.choice(list(READERS)))
            yield Trial(
                "metadata, deep", f"{verb}: {name}", _with_metadata(base, verb, text), ALLOWED, ("data",)
            )
        for name, run in RUNS.items():
            verb = str(rng.choice(list(READERS)))
            yield Trial("metadata, deep", f"{verb}: {name}", _with_run(base, verb, run), ALLOWED, ("data",))


def _with_metadata(base: Bags, verb: str, text: Callable) -> Callable:
    def make(folder: Path) -> list:
        shutil.copytree(base.file, folder / "data")
        file = folder / "data" / "metadata.yaml"
        changed = text(file.read_text())
        if changed is None:
            file.unlink()
        else:
            file.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
        return READERS[verb](base, folder)

    return make


def _with_run(base: Bags, verb: str, run: Callable) -> Callable:
    def make(folder: Path) -> list:
        bags.write(folder / "data", base.walk._replace(run=run(dict(base.walk.run))))
        return READERS[verb](base, folder)

    return make


# what each verb is asked to do with the bag `data` in a trial's folder
READERS: dict[str, Callable[[Bags, Path], list]] = {
    "check": lambda base, folder: ["check", folder / "data", "--partial"],
    "report": lambda base, folder: ["report", folder / "data", "--out", folder / "out"],
    "recover": lambda base, folder: ["recover", folder / "data", "--out", folder / "out"],
    "replay": lambda base, folder: ["replay", folder / "data", "--node", "data"],
    "identify": lambda base, folder: ["identify", folder / "data", *base.rig],
    "gap": lambda base, folder: ["gap", folder / "data", "--held-out", base.source, "--until", "check"],
    "plan": lambda base, folder: ["plan", "--after", folder / "data", "--out", folder / "out"],
    "batch": lambda base, folder: [
        "batch",
        "check",
        folder / "data",
        "--out",
        folder / "out",
        "--retries",
        "0",
    ],
}


def table_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, tables with which `identify` and `gap` begin in earnest, spoilt or slightly off."""
    tables = {"identify": rig_table(), "gap": walk_table(base.source)}
    while True:
        for kinds in (NUDGES, TABLES):
            for verb, text in tables.items():
                what = str(rng.choice(list(kinds)))
                changed = kinds[what](text, rng)
                yield Trial(
                    "table, deep", f"{verb}: {what}", _with_table(base, verb, changed), ALLOWED, BY_NAME
                )


def _with_table(base: Bags, verb: str, changed: str | bytes) -> Callable:
    def make(folder: Path) -> list:
        file = folder / "dmsp20.csv"
        file.write_bytes(changed.encode() if isinstance(changed, str) else changed)
        if verb == "gap":
            return [verb, file, "--held-out", base.source, "--until", "check"]
        return [verb, file, *RIG_OPTIONS, "0.3", "--out", folder / "rows.yaml"]

    return make


def _nudged(factor: float) -> Callable:
    """Return what multiplies one column by numbers about 1, so that all checks of a cell are passed."""

    def change(text: str, rng: np.random.Generator) -> str:
        header, *rows = [line.split(",") for line in text.splitlines()]
        column = int(rng.integers(1, len(header)))
        for row in rows:
            row[column] = f"{float(row[column]) * (1 + factor * rng.standard_normal()):.9g}"
        return "\n".join(",".join(row) for row in [header, *rows]) + "\n"

    return change


def _constant(text: str, rng: np.random.Generator) -> str:
    header, *rows = [line.split(",") for line in text.splitlines()]
    column = int(rng.integers(1, len(header)))
    return (
        "\n".join(
            ",".join(row)
            for row in [header, *([*r[:column], rows[0][column], *r[column + 1 :]] for r in rows)]
        )
        + "\n"
    )


def _few(text: str, rng: np.random.Generator) -> str:
    return "\n".join(text.splitlines()[: int(rng.integers(3, 40))]) + "\n"


NUDGES = {
    "a column with noise": _nudged(1e-3),
    "a column with much noise": _nudged(0.1),
    "a constant column": _constant,
    "a few rows": _few,
    "a column of tiny numbers": _nudged(math.ulp(1.0)),
}
