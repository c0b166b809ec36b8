# SPDX-License-Identifier: Apache-2.0
"""Ways to spoil what people write: parameters, files of config/, model files, tables, folders, options."""

from __future__ import annotations

import itertools
import resource
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from fault_campaign.bag_mutations import BYTES, SMUGGLE, Bags
from fault_campaign.trial import ANY, REFUSED, Trial
from pam_orthosis.bag.read import read_bag
from pam_orthosis.model import parameters
from pam_orthosis.model.components import muscle
from pam_orthosis.model.rules import ALIKE

WEIRD = (
    "", "null", "~", "yes", "[]", "{}", "[1]", "{a: 1}", "two", "1e999", ".nan", ".inf", "-.inf", "1,5",
    "0x10", "1_000", "2026-01-01", "''", "'\u0000'", "1 2", "*a", "&a 1", "!!binary aGk=", SMUGGLE,
    "!!python/name:os.system", "!!python/object/new:os.system ['true']", "9" * 400, "\u0661\u0662", "- 1",
)  # fmt: skip


def parameter_trials(rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, settings of single parameters; the run itself is prevented by its folder."""
    rows = parameters.load().rows()
    while True:
        row = rows[int(rng.integers(len(rows)))]
        yield _setting("unknown key", f"{row.key}{rng.choice(['s', '_', '.value', ' '])}", "1", (row.key,))
        text = str(rng.choice(WEIRD))
        yield _setting("weird value", row.key, text, ())
        if isinstance(row.value, bool | str):
            yield _setting("wrong type", row.key, "0.5", (row.key,))
        elif isinstance(row.value, list):
            yield _setting("wrong length", row.key, str([1.0] * (len(row.value) + 1)), (row.key,))
            yield _setting(
                "NaN in a list", row.key, str([".nan"] * len(row.value)).replace("'", ""), (row.key,)
            )
        else:
            yield _setting("wrong type", row.key, str(rng.choice(["high", "true", "[1.0]"])), (row.key,))
            yield _setting("not finite", row.key, str(rng.choice([".nan", "inf", "-inf"])), (row.key,))
            end, away = (row.minimum, -1) if rng.random() < 0.5 else (row.maximum, 1)
            beyond = end + away * (abs(end) * rng.uniform(0.01, 10) + 1)
            yield _setting("out of range", row.key, repr(int(beyond) if isinstance(end, int) else beyond),
                           (row.key,))  # fmt: skip


def _setting(kind: str, key: str, text: str, names: tuple[str, ...], also: Sequence[str] = ()) -> Trial:
    def make(folder: Path) -> list:
        (folder / "out").mkdir()
        (folder / "out" / "mine.txt").write_text("kept")
        settings = [word for setting in (*also, f"{key}={text}") for word in ("--param", setting)]
        return ["run", "--out", folder / "out", *settings]

    return Trial("parameter", f"{kind}: {key}={text[:40]}", make, REFUSED, names)


# key, value, what the refusal names, further settings
PAIRS = (
    ("leg.joint.minimum", "1.0", "leg.joint.maximum", "leg.joint.maximum=0.9"),
    ("valve.closed_voltage", "10.0", "valve.maximum_voltage"),
    ("valve.minimum_voltage", "6.0", "valve.closed_voltage"),
    ("valve.supply_pressure", "5.0e+5", "control.position.maximum_pressure"),
    ("control.position.minimum_pressure", "4.0e+5", "control.position.mean_pressure"),
    ("control.position.mean_pressure", "6.8e+5", "control.position.maximum_pressure"),
    ("scenario.control_period", "0.00123", "plant.simulation.step"),
    ("scenario.diagnostic.low_angle", "1.2", "scenario.diagnostic.high_angle"),
    ("scenario.diagnostic.low_mean", "5.5e+5", "scenario.diagnostic.high_mean"),
    ("scenario.start_angle", "1.5", "leg.joint.maximum", "leg.joint.maximum=1.3"),
    ("scenario.sine.amplitude", "0.8", "scenario.sine", "scenario.trajectory=sine"),
    ("scenario.duration", "0.1", "scenario.control_period", "scenario.control_period=0.05"),
    ("muscle.dmsp_20.box.minimum_contraction", "0.3", "muscle.dmsp_20.box.maximum_contraction"),
    ("scenario.gait.cosine", "[4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "leg.joint"),
)


LISTS = (
    "scenario.gait.cosine",
    "rig.procedure.pressures",
    "muscle.dmsp_20.force.a",
    "muscle.dmsp_10.volume.v",
)


def slip_trials() -> Iterator[Trial]:
    """Yield decimal points that slipped, and pairs that contradict each other; all are to be refused."""
    values = parameters.load().flat()
    for key in (*itertools.chain(*ALIKE), *LISTS):
        for factor in (0.1, 10.0) if key != "scenario.gait.cosine" else (10.0,):
            slipped = values[key]
            slipped = [factor * v for v in slipped] if isinstance(slipped, list) else factor * slipped
            yield _setting("ten-fold slip", key, repr(slipped), (key.rpartition(".")[0],))
    for key, text, other, *also in PAIRS:
        yield _setting("inconsistent pair", key, text, (other,), also)


def config_trials(rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, edited files of config/."""
    names = [f"{subject}.yaml" for subject in parameters.SUBJECTS]
    while True:
        name = str(rng.choice(names))
        for what, edit in CONFIG.items():
            yield _config(name, what, edit, int(rng.integers(2**32)))
        for what, edit in SCENARIO.items():
            yield _config("scenario.yaml", what, edit, int(rng.integers(2**32)), REFUSED)


def _config(name: str, what: str, edit: Callable, seed: int, allowed=ANY) -> Trial:
    def make(folder: Path) -> list:
        shutil.copytree(parameters.config_folder(), folder / "config")
        file = folder / "config" / name
        rng = np.random.default_rng(seed)
        changed = edit(file.read_text(encoding="utf-8"), rng)
        file.write_bytes(changed if isinstance(changed, bytes | bytearray) else changed.encode())
        (folder / "out").mkdir()
        (folder / "out" / "mine.txt").write_text("kept")
        return ["run", "--out", folder / "out"]

    return Trial("config file", f"{name}: {what}, seed {seed}", make, REFUSED, prepare=_own_config)


def _own_config(folder: Path) -> None:
    """Make this process read config/ from the trial's folder."""
    parameters.config_folder = lambda: folder / "config"
    for cached in (parameters._shipped_rows, parameters._scenarios):
        cached.cache_clear()


def _line(text: str, rng, change: Callable[[str], str], needle: str = "value:") -> str:
    """Change one line that holds the needle."""
    lines = text.splitlines(keepends=True)
    places = [place for place, line in enumerate(lines) if needle in line]
    place = int(rng.choice(places))
    lines[place] = change(lines[place])
    return "".join(lines)


def _valued(replacement: str) -> Callable:
    def change(line: str) -> str:
        head, _, tail = line.partition("value: ")
        _, comma, rest = tail.partition(", unit") if ", unit" in tail else tail.partition(", m")
        return f"{head}value: {replacement}{comma}{rest}" if comma else line

    return lambda text, rng: _line(text, rng, change)


def _spoilt(spoil: Callable) -> Callable:
    return lambda text, rng: spoil(bytearray(text.encode()), rng)


def _replaced(old: str, new: str) -> Callable:
    return lambda text, rng: _line(text, rng, lambda line: line.replace(old, new), old)


def _appended(line: str) -> Callable:
    return lambda text, rng: f"{text}\n{line}\n"


VALUES = ("", "null", "high", ".nan", "1e999", "[1, 2]", "{a: 1}", "true", "-1.0e+30", SMUGGLE)
CONFIG = {
    **{f"value {text[:20]!r}": _valued(text) for text in VALUES},
    **{name: _spoilt(spoil) for name, spoil in BYTES.items()},
    "a row without meaning": _replaced("meaning:", "sense:"),
    "a row without value": _replaced("value:", "worth:"),
    "an unknown field": _replaced("value:", "colour: red, value:"),
    "bounds that are texts": _replaced("min: ", "min: x"),
    "a line left out": lambda text, rng: _line(text, rng, lambda line: ""),
    "a line twice": lambda text, rng: _line(text, rng, lambda line: line + line),
    "a tab": lambda text, rng: _line(text, rng, lambda line: "\t" + line),
    "a section that is a number": _appended("extra: 3"),
    "a section that is null": _appended("extra:"),
    "a key that is a number": _appended("3: {value: 1.0, unit: m, meaning: x, source: y}"),
    "an unknown parameter": _appended("extra: {value: 1.0, unit: m, meaning: x, source: y}"),
    "a list": lambda text, rng: "[1, 2, 3]",
    "empty": lambda text, rng: "",
    "nested too deeply": lambda text, rng: "[" * 5000,
}


def _scenario(entry: str) -> Callable:
    return lambda text, rng: text.replace(
        '  default: {meaning: "gait without a person, 2 s a cycle (as the paper measured)", set: {}}',
        f"  default: {entry}",
    )


SCENARIO = {
    f"scenario {entry[:30]!r}": _scenario(entry)
    for entry in (
        "3", "null", "{}", "[1]", "{meaning: x, set: 3}", "{meaning: x, set: [a]}", "{meaning: 3}",
        "{meaning: x, set: {leg.tail: 1}}", "{meaning: x, set: {3: 1}}", "{set: {}}",
        "{meaning: x, set: {scenario.duration: .nan}}", "{meaning: x, set: {scenario: {duration: 1.0}}}",
    )
}  # fmt: skip


def model_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, model files for `gap --model`; the search is prevented by a missing recording."""
    while True:
        for text in (*WEIRD, *MODELS):
            yield _model(text.encode())
        for name, spoil in BYTES.items():
            yield _model(spoil(bytearray(MODEL.encode()), rng), name)


def _model(data: bytes, what: str = "") -> Trial:
    def make(folder: Path) -> list:
        (folder / "model.yaml").write_bytes(data)
        return ["gap", "missing", "--model", folder / "model.yaml"]

    return Trial("model file", what or data.decode()[:40], make, REFUSED)


ALIASES = tuple(itertools.pairwise("abcdefghijklmnopqr"))  # 3 to the 17th
MODEL = "effects.joint_friction.enabled: true\nleg:\n  shank:\n    length: 0.41\n"
MODELS = (
    "- a\n", "leg: 3\n", "leg: {shank: {length: long}}\n", "leg.shank.length: [1]\n", "3: 4\n", "null: 1\n",
    "? [a]\n: 1\n", "a: &a {b: *a}\n", "leg.shank.length: 0.4\nleg.shank.length: 0.4\n", "leg..shank: 1\n",
    "plant.muscle_law: polynomial\n", "effects.joint_friction.enabled: 1\n", "effects.tail.enabled: true\n",
    "leg: {<<: 3}\n", "%YAML 9.9\n---\na: 1\n", "--- 1\n--- 2\n", "\ufeffleg.shank.length: x\n",
    "a: &a {x: 1, y: 2}\n" + "".join(f"{b}: &{b} {{s: *{a}, t: *{a}, u: *{a}}}\n" for a, b in ALIASES),
)  # fmt: skip


def table_trials(base: Bags, rng: np.random.Generator) -> Iterator[Trial]:
    """Yield, without end, spoilt CSV tables for `identify` and `gap`."""
    tables = {"identify": rig_table(), "gap": walk_table(base.file)}
    while True:
        for verb, text in tables.items():
            for what, spoil in TABLES.items():
                yield _table(verb, what, spoil(text, rng))
            for what, spoil in BYTES.items():
                yield _table(verb, what, spoil(bytearray(text.encode()), rng))


def _table(verb: str, what: str, changed: str | bytes) -> Trial:
    def make(folder: Path) -> list:
        file = folder / "dmsp20_table.csv"
        file.write_bytes(changed.encode() if isinstance(changed, str) else changed)
        more = [folder / "missing"] if verb == "gap" else []
        return [verb, file, *more]

    return Trial("table", f"{verb}: {what}", make, REFUSED if verb == "gap" else ANY)


def rig_table() -> str:
    """Return a table of forces over pressures and contractions, of the shipped muscle."""
    m = parameters.load().muscle.dmsp_20
    rows = ["p_Pa_gauge,dL_m,F_N"]
    for bar in range(1, 7):
        for step in range(12):
            contraction = 0.01 * step
            force = float(muscle.towing_force(contraction, bar * 1e5, m))
            rows += [f"{bar * 1e5:g},{contraction:g},{force:.3f}"] * (force > 0)
    return "\n".join(rows) + "\n"


def walk_table(bag: Path) -> str:
    """Return a bag as the table that `gap` reads."""
    names = ["angle", "extensor_pressure", "flexor_pressure", "extensor_voltage", "flexor_voltage"]
    read = read_bag(bag, names)
    columns = [(read["angle"].stamp_ns - read["angle"].stamp_ns[0]) * 1e-9]
    columns += [read[name].value for name in names]
    rows = [",".join(["time", *names])]
    return "\n".join(rows + [",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]) + "\n"


def _cell(text: str, rng, value: str | Callable[[str], str], row: int | None = None) -> str:
    rows = [line.split(",") for line in text.splitlines()]
    cells = rows[int(rng.integers(1, len(rows))) if row is None else row]
    column = int(rng.integers(len(cells)))
    cells[column] = value if isinstance(value, str) else value(cells[column])
    return "\n".join(",".join(cells) for cells in rows) + "\n"


def _scaled(factor: float) -> Callable[[str], str]:
    return lambda cell: f"{factor * float(cell):g}"


def _column(text: str, rng, factor: float) -> str:
    rows = [line.split(",") for line in text.splitlines()]
    column = int(rng.integers(len(rows[0])))
    body = [[*r[:column], f"{factor * float(r[column]):g}", *r[column + 1 :]] for r in rows[1:]]
    return "\n".join(",".join(r) for r in [rows[0], *body]) + "\n"


def _with_cell(cell: str, row: int | None = None) -> Callable:
    return lambda text, rng: _cell(text, rng, cell, row)


def _cell_times(factor: float) -> Callable:
    return lambda text, rng: _cell(text, rng, _scaled(factor))


def _column_times(factor: float) -> Callable:
    return lambda text, rng: _column(text, rng, factor)


def _rows_in_any_order(text: str, rng) -> str:
    header, *rows = text.splitlines()
    return "\n".join([header, *rng.permutation(rows)]) + "\n"


CELLS = ("", "nan", "inf", "-", "1,5", "x", "1e999", '"', "=SUM(A1)", "\u0000", "9" * 400, "0x1")
TABLES = {
    **{f"a cell {cell[:20]!r}": _with_cell(cell) for cell in CELLS},
    **{f"a cell times {factor:g}": _cell_times(factor) for factor in (0.1, 10.0, -1.0, 1e6)},
    **{f"a column times {factor:g}": _column_times(factor) for factor in (1e-5, 1e-3, 10.0, 1e3)},
    **{f"a header {name[:9]!r}": _with_cell(name, 0) for name in ("", "p_psi", "F_N", "time", "x" * 5000)},
    "no rows": lambda text, rng: text.splitlines()[0] + "\n",
    "one row": lambda text, rng: "\n".join(text.splitlines()[:2]) + "\n",
    "no header": lambda text, rng: "\n".join(text.splitlines()[1:]),
    "empty": lambda text, rng: "",
    "blank lines": lambda text, rng: text.replace("\n", "\n\n", 5),
    "semicolons": lambda text, rng: text.replace(",", ";"),
    "decimal commas": lambda text, rng: text.replace(".", ","),
    "an open quote": lambda text, rng: text.replace("\n", '\n"', 1),
    "a byte order mark": lambda text, rng: "\ufeff" + text,
    "UTF-16": lambda text, rng: text.encode("utf-16"),
    "every row twice": lambda text, rng: text + "\n".join(text.splitlines()[1:]) + "\n",
    "rows in any order": _rows_in_any_order,
    "one line of a million cells": lambda text, rng: text + "1," * 1_000_000,
}


def place_trials(base: Bags) -> Iterator[Trial]:
    """Yield places that cannot be written, or where something is already."""
    for verb, source in (
        ("report", base.file),
        ("recover", base.file),
        ("rig", None),
        ("identify", base.rig[1]),
    ):
        for what, (build, prepare) in PLACES.items():
            if what == "a run is there" and verb in ("report", "identify"):
                continue  # a picture is drawn anew, and rows are what the user names
            make = _written_to(verb, source, build)
            yield Trial("place to write", f"{verb}: {what}", make, REFUSED, ("out",), prepare)
    for what, (build, _) in PLACES.items():
        if what != "the disk is full":
            yield Trial("place to write", f"run: {what}", _written_to("run", None, build), REFUSED, ("out",))


def _written_to(verb: str, source: Path | None, build: Callable[[Path], Path]) -> Callable:
    def make(folder: Path) -> list:
        out = build(folder)
        given = [source] if source else []
        if verb == "identify":
            return [verb, *[source.parent / name for name in ("force-0", "force-1", "force-2")], "--out", out]
        quick = {"rig": ["--tests", "decay"], "run": ["--duration", "0.2"]}
        return [verb, *given, "--out", out, *quick.get(verb, [])]

    return make


def _below_a_file(folder: Path) -> Path:
    (folder / "out").write_text("kept")
    return folder / "out" / "new"


def _read_only(folder: Path) -> Path:
    return Path("/proc/out")  # even root creates nothing there


def _occupied(folder: Path) -> Path:
    (folder / "out").mkdir()
    for name in ("mine.txt", "out_0.mcap", "metadata.yaml"):
        (folder / "out" / name).write_text("kept")
    return folder / "out"


def _new(folder: Path) -> Path:
    return folder / "out"


def _full_disk(folder: Path) -> None:
    """Let no file grow beyond a few bytes: a write then fails as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))


PLACES = {
    "below a file": (_below_a_file, None),
    "a folder that cannot be written": (_read_only, None),
    "a run is there": (_occupied, None),
    "the disk is full": (_new, _full_disk),
}


def option_trials() -> Iterator[Trial]:
    """Yield wrong options of each verb."""
    for arguments in OPTIONS:
        yield Trial("option", " ".join(arguments)[:60], lambda folder, given=arguments: list(given), REFUSED)


OPTIONS = (
    [""],
    ["\u0000"],
    ["walk"],
    ["check"],
    ["check", ""],
    ["check", "."],
    ["check", "/dev/null"],
    ["check", "/proc"],
    ["check", "x" * 5000],
    ["check", ".", "--bound-deg", "-1"],
    ["check", ".", "--bound-deg", "inf"],
    ["check", ".", "--skip-s", "nan"],
    ["run", "--duration", "1e400"],
    ["run", "--duration", "0"],
    ["run", "--seed", "-1"],
    ["run", "--seed", "99999999999999999999"],
    ["run", "--seed", "1.5"],
    ["run", "--scenario", ""],
    ["run", "--scenario", "../default"],
    ["run", "--param", ""],
    ["run", "--param", "="],
    ["run", "--no-plant"],
    ["run", "--out", "x" * 5000],
    ["rig", "--seed", "-1"],
    ["rig", "--load-cell", "nan"],
    ["rig", "--muscle", "biceps"],
    ["rig", "--tests", "all"],
    ["identify", "nowhere"],
    ["identify", "."],
    ["identify", "/dev/null"],
    ["identify", ".", "--nominal-length-m", "0"],
    ["identify", ".", "--degrees", "9", "9"],
    ["identify", ".", "--held-out-bar", "x"],
    ["gap", "nowhere"],
    ["gap", "/dev/null"],
    ["gap", "."],
    ["gap", "nowhere", "--model", "nowhere"],
    ["gap", "nowhere", "--model", "."],
    ["report", "nowhere"],
    ["report", "/dev/null"],
    ["recover", "/dev/null"],
    ["recover", ""],
    ["recover", "/dev/zero"],
    ["gap-hide", "--seed", "-1", "--out", "x"],
    ["gap-hide", "--effect", "tail", "--out", "x"],
    ["gap-hide"],
)
