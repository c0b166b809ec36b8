# SPDX-License-Identifier: Apache-2.0
"""Summary tables of `benchmarks/results/`, and of the reference bags."""

import json
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

from generators.markdown import table
from pam_orthosis.bag.verdict import judge
from pam_orthosis.model.parameters import scenario_names
from pam_orthosis.report import improvement
from pam_orthosis.report.paper import table as tables

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
sys.path.insert(0, str(ROOT / "benchmarks"))

import cooperation  # noqa: E402
import device  # noqa: E402
import gap_table  # noqa: E402
import identify_repeats  # noqa: E402
import repetition  # noqa: E402
import safety  # noqa: E402
from control_campaign.cases import PEERS  # noqa: E402
from speed.rows import as_text  # noqa: E402

BOUND = 3.0  # deg
LATEST = ("490851", "531983", "790683", "640029", "880612")  # sets of the gap workflow, the last ones
LATEST_OUTSIDE = "531983"  # the same, of effects outside the catalogue
LATEST_PAIRS = ("880612",)  # the same, of pairs: by the present rule for a small effect beside a large one
BLIND = (
    "515151",
    "626262",
    "737373",
    "959595",
    "161616",
    "272727",
    "383838",
    "848484",
    "804558",
    "693684",
    "226205",
    "566587",
    "278193",
    "61357",
    "389573",
    "485121",
    "984900",
    "268208",
    "274523",
    "600960",
    "365451",
    "873252",
    *LATEST,
)  # sets of cases, newest last
# (set, size) of blind cases -> share that is asked to be right; goals of the study before the workflow
ASKED = {
    ("clean", "small"): 0.75,
    ("clean", "medium"): 0.90,
    ("clean", "large"): 0.99,
    ("realistic", "small"): None,
    ("realistic", "medium"): 0.90,
    ("realistic", "large"): 0.97,
    ("pairs", ""): 0.90,
    ("clean-none", ""): 0.99,
    ("realistic-none", ""): 0.99,
    ("outside", ""): 1.0,
}
CLEAR = 1.2  # times the noise, a gap: of smaller ones noise alone changes which share is closed
BAGS = {"walk": "default", "person": "person"}  # reference bag -> its scenario
TASKS = ("gait 2 s", "gait 2 s, 75 kg", "gait 2 s, 75 kg, supply of 7 bar")
CONTROLLERS = ("paper", "learned", "calm", "planned")
LABELS = {"paper": "nominal"}  # controller in the results -> in the table
PEER_TASKS = (TASKS[0], TASKS[2], "push", "block")
PEER_HEAD = (
    "law", "gait: error / deg", "with a person", "above 3 deg", "gait: valve / V/s", "with a person",
    "stiffness to a push / N m/rad", "felt when blocking / N m", "speed after it / rad/s",
)  # fmt: skip
CASCADES = {"paper": "no predictor"}
DELAY_COLUMNS = [(cascade, wearer) for wearer in ("nobody", "person") for cascade in ("predictor", "paper")]
DELAY_COLUMNS.append(("one gain set", "person"))
SPEED = {
    "graph": (
        "simulated time at 500 Hz, processes, recorder included, beside that of the relays",
        "simulated time at 500 Hz, one process, recorder included, beside that of the relays",
    ),
    "device": (
        "simulated time at 500 Hz, the device, beside that of the relays",
        "latency of the device at 200 Hz, one process: answers later than a period",
    ),
    "start": ("time to the first step, processes", "time to the first step, one process"),
    "bags": ("a simulated minute at 200 Hz, beside the bare messages",),
    "latency": (
        "latency at 200 Hz, processes: median",
        "latency at 200 Hz, processes: 99th percentile",
        "latency at 200 Hz, one process: median",
        "latency at 200 Hz, one process: 99th percentile",
        "latency at 200 Hz, one process: answers later than a period",
        "latency at 200 Hz, one process a leg, two legs: 99th percentile",
        "latency at 200 Hz, one process a leg, two legs: answers later than a period",
        "a bare timer at 200 Hz: wakes later than half a period",
    ),
    "simulation": (
        "one plant, beside SciPy with no larger errors",
        "one plant, beside MuJoCo's Euler at the same step",
        "1,000 random sets of 8 parameters, beside SciPy with one",
    ),
    "scaling": (
        "gap workflow, 60 s recorded, by the clock on the wall",
        "gap workflow: time per size, 600 s recorded beside 60",
        "identification: time per size, 619710 samples beside 61971",
    ),
}


def blocks() -> dict[str, Callable[[], str]]:
    """Return the tables by their names."""
    return {
        "tracking": tracking,
        "gap": lambda: gap(blind_cases()),
        "gap-asked": gap_asked,
        "gap-sets": gap_sets,
        "gap-pairs": gap_pairs,
        "gap-wrong": gap_wrong,
        "gap-fuzz": gap_fuzz,
        "gap-own": gap_own,
        "gap-ankle": gap_ankle,
        "gap-outside": gap_outside,
        "gap-peer": gap_peer,
        "control": control,
        "peers": peers,
        "delay": delay,
        "improve-default": lambda: improve("default"),
        "improve-person": lambda: improve("person"),
        "speed": speed,
        "paper": paper,
        "paper-observer": paper_observer,
        "paper-hand": lambda: _listed(tables.by_hand(paper_results()["by_hand"])),
        "paper-force-rate": lambda: _listed(tables.force_rate(paper_results()["force_rate"])),
        "paper-inertia": lambda: _listed(tables.inertia(paper_results()["inertia"])),
        "device": device_table,
        "safety": lambda: _text(safety.table(safety.summary(safety.read(RESULTS / "safety.jsonl")))),
        "spasms": lambda: _text(safety.sizes(safety.read(RESULTS / "safety.jsonl"))),
        "stiffness-asked": lambda: _text(cooperation.stiffness_table(_cooperation())),
        "assistance": lambda: _text(cooperation.share_table(_cooperation())),
        "felt": lambda: _text(cooperation.felt_table(_cooperation())),
        "identify-repeats": lambda: _text(identify_repeats.table(_lines(RESULTS / "identify_repeats.jsonl"))),
        "repetition": lambda: _text(repetition.table(_lines(RESULTS / "repetition.jsonl"))),
        "stiffness": lambda: (RESULTS / "stiffness.md").read_text(encoding="utf-8"),
    }


def _text(lines: Iterable[str]) -> str:
    return "\n".join(lines) + "\n"


def _cooperation() -> dict[str, list[dict[str, Any]]]:
    return json.loads((RESULTS / "cooperation.json").read_text(encoding="utf-8"))


def tracking() -> str:
    """Return the tracking of the reference bags beside the paper's figures."""
    rows = [("paper: device without a person, delay not stated", "about 3 deg", "-", "below 1 deg", "-")]
    for name, scenario in BAGS.items():
        v = judge(ROOT / "bags" / name)
        variation = ", ".join(f"{value:.0f}" for value in v.voltage_variation_per_s.values())
        rows.append((
            f"emulation, `{name}`: {scenario_names()[scenario]}", f"{v.max_abs_error:.2f} deg",
            f"{v.rms_error:.2f} deg", f"{v.steady_state_error:.2f} deg", f"{variation} V/s",
        ))  # fmt: skip
    return table(("run", "maximum error", "RMS error", "steady state", "voltage variation"), rows)


@cache
def blind_set(seed: str) -> list[dict[str, Any]]:
    """Return the results of one set of blind cases of the gap workflow."""
    return gap_table.read(RESULTS / f"gap_blind_{seed}.jsonl")


def blind_cases() -> list[dict[str, Any]]:
    """Return the results of all blind cases."""
    return [case for seed in BLIND for case in blind_set(seed)]


def gap(cases: Sequence[dict[str, Any]]) -> str:
    """Return what became of blind cases."""
    rows = [
        (
            f"one effect, {size}, {name}", str(len(chosen)),
            f"named: {_share(*right(chosen))}", _share(*wrong(chosen)),
        )
        for size in gap_table.SIZES for name in ("clean", "realistic")
        if (chosen := chosen_of(cases, name, size))
    ]  # fmt: skip
    pairs = chosen_of(cases, "pairs")
    rows.append(("two effects", str(len(pairs)), f"both named: {_share(*both(pairs))}", "-"))
    for name in ("clean", "realistic"):
        none = chosen_of(cases, f"{name}-none")
        rows.append((f"nothing hidden, {name}", str(len(none)), f"verdict none: {_share(*quiet(none))}", "-"))
    outside = chosen_of(cases, "outside")
    named = sum("found" in r and bool(gap_table.names(r)) for r in outside)
    counts = open_verdicts(outside)
    words = "; ".join(f"verdict {name}: {_share(n, len(outside))}" for name, n in counts.items() if n)
    rows.append(("an effect outside the catalogue", str(len(outside)), words, _share(named, len(outside))))
    return table(("hidden", "cases", "right", "a wrong name"), rows)


def gap_asked() -> str:
    """Return for each class of cases of the last blind sets what is asked and what was reached."""
    cases, rows = latest_cases(), []
    for (name, size), asked in ASKED.items():
        if not (chosen := chosen_of(cases, name, size)):
            continue
        words, (part, whole) = _reached(name, chosen)
        hidden = f"one effect, {size}, {name}" if size else words
        met = "-" if asked is None else "yes" if part >= asked * whole else "no"
        small = sum(map(gap_table.too_small, chosen)) if size else _hidden_from_all(chosen)
        rows.append((
            hidden, "-" if asked is None else f"{asked:.0%}", _share(part, whole), met,
            "-" if small is None else str(small),
        ))  # fmt: skip
    rows += [
        (what, f"{asked:.0%}", _share(part, whole), "yes" if part >= asked * whole else "no", "-")
        for what, asked, (part, whole) in _qualities(cases)
        if whole
    ]
    return table(("right", "asked", "reached", "met", "missed: too small to be found"), rows)


def _qualities(cases: Sequence[dict[str, Any]]) -> Iterable[tuple[str, float, tuple[int, int]]]:
    """Yield what is asked beside names: what it is, the share asked, how many of how many reached it."""
    singles = {name: chosen_of(cases, name) for name in ("clean", "realistic")}
    yield "names given, clean", 0.99, gap_table.right_names(singles["clean"])
    yield "names given, realistic", 0.98, gap_table.right_names(singles["realistic"])
    both = [*singles["clean"], *singles["realistic"]]
    closed = "95 % of the gap closed, where it is called explained"
    yield closed, 0.95, gap_table.closed(both)
    large = [r for r in both if "found" in r and r["found"]["gap_before"]["overall"]["value"] >= CLEAR]
    yield f"the same, of gaps from {CLEAR} times the noise on", 0.95, gap_table.closed(large)
    yield "intervals of effects of the same form", 0.9, gap_table.held(both)
    for what, asked, on in (("on the right signal", 0.8, True), ("on no signal of the instant", 0.9, False)):
        outside = [r for r in chosen_of(cases, "outside") if bool(gap_table.DEPENDS[r["effects"][0]]) == on]
        right = sum("found" in r and gap_table.told_rightly(r) for r in outside)
        yield f"an effect outside, said to depend {what}", asked, (right, len(outside))


def latest_cases() -> list[dict[str, Any]]:
    """Return the cases of the last sets, pairs by the present rule only."""
    cases = [(seed, case) for seed in LATEST for case in blind_set(seed)]
    return [case for seed, case in cases if case["set"] != "pairs" or seed in LATEST_PAIRS]


def _hidden_from_all(cases: Sequence[dict[str, Any]]) -> int | None:
    """Return in how many pairs recordings do not show what was missed; None of other cases."""
    seeds = {case["seed"] for case in cases if case["set"] == "pairs"}
    return sum(r["at_most"] < gap_table.DETECTABLE for r in _bounds_of(seeds)) if seeds else None


def _bounds_of(seeds: Collection[int]) -> list[dict[str, Any]]:
    """Return the bounds of what was missed in some pairs."""
    return [r for r in gap_table.read(RESULTS / "gap_pairs.jsonl") if r["seed"] in seeds]


def _reached(name: str, chosen: Sequence[dict[str, Any]]) -> tuple[str, tuple[int, int]]:
    """Return what counts as right in a set of blind cases, and how many of how many are."""
    if name == "pairs":
        return "two effects, both named", both(chosen)
    if name == "outside":
        unnamed = sum("found" in case and not gap_table.names(case) for case in chosen)
        return "an effect outside the catalogue, no name", (unnamed, len(chosen))
    if name.endswith("-none"):
        return f"nothing hidden, {name.removesuffix('-none')}, verdict `none`", quiet(chosen)
    return "named", right(chosen)


def gap_sets() -> str:
    """Return what became of each set of blind cases, the newest last."""
    rows = []
    for seed in BLIND:
        cases = blind_set(seed)
        single = [r for r in cases if r["set"] in ("clean", "realistic")]
        none = [r for r in cases if r["set"].endswith("-none")]
        counted = (right(single), wrong(single), both(chosen_of(cases, "pairs")), quiet(none))
        outside = chosen_of(cases, "outside")
        counts = ", ".join(str(n) for n in open_verdicts(outside).values()) + f" of {len(outside)}"
        cells = [f"{part} of {whole}" if whole else "-" for part, whole in counted]
        bounded = any("at_most" in r for r in single)
        small = str(sum(map(gap_table.too_small, single))) if bounded else "-"
        false = str(sum(map(gap_table.falsely_explained, cases)))
        rows.append((seed, *cells, counts if outside else "-", false, small))
    head = ("set", "one effect: named", "a wrong name", "two effects: both named", "nothing hidden: `none`")
    verdicts = ", ".join(f"`{name}`" for name in gap_table.OPEN)
    last = "`explained` by a wrong name", "one effect: too small to be found (`gap_bound.py`)"
    return table((*head, f"outside the catalogue: {verdicts}", *last), rows)


def gap_pairs() -> str:
    """Return the evidence that effects which were missed in pairs could have beside the other one."""
    rows = [
        (f"`{r['missed']}`", f"`{r['beside']}`", f"{r['at_most']:.0f}", f"{r['asked']:.0f}")
        for r in _bounds_of({case["seed"] for seed in LATEST_PAIRS for case in blind_set(seed)})
    ]
    return table(("missed", "beside", "evidence at most", "asked at least"), rows)


def chosen_of(cases: Iterable[dict[str, Any]], name: str, size: str = "") -> list[dict[str, Any]]:
    """Return the cases of one kind, of one size if that is given."""
    return [r for r in cases if r["set"] == name and size in ("", r["size"])]


def right(cases: Sequence[dict[str, Any]]) -> tuple[int, int]:
    """Return how many cases with one effect got its name, of how many."""
    return sum(gap_table.judged(case) in ("right", "set") for case in cases), len(cases)


def wrong(cases: Sequence[dict[str, Any]]) -> tuple[int, int]:
    """Return how many cases with one effect got a wrong name, of how many."""
    return sum(gap_table.judged(case) in ("wrong", "extra") for case in cases), len(cases)


def both(pairs: Sequence[dict[str, Any]]) -> tuple[int, int]:
    """Return in how many cases with two effects both are named, of how many."""
    return sum("found" in r and set(r["effects"]) <= set(gap_table.names(r)) for r in pairs), len(pairs)


def quiet(cases: Sequence[dict[str, Any]]) -> tuple[int, int]:
    """Return how many cases in which nothing is hidden have the verdict none, of how many."""
    return sum("found" in r and r["found"]["verdict"] == "none" for r in cases), len(cases)


def open_verdicts(outside: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Return verdict on a gap that is not explained -> how many cases outside the catalogue have it."""
    verdicts = [r["found"]["verdict"] for r in outside if "found" in r]
    return {name: verdicts.count(name) for name in gap_table.OPEN}


def wrong_parameters() -> list[dict[str, Any]]:
    """Return the cases of wrong parameters, of all draws of what is off beside them."""
    return [case for file in sorted(RESULTS.glob("gap_wrong*.jsonl")) for case in gap_table.read(file)]


def gap_wrong() -> str:
    """Return what became of wrong parameters, all draws of a mistake in one row."""
    rows, cases = [], sorted(wrong_parameters(), key=lambda r: r["number"])
    for _, group in groupby(cases, key=lambda r: r["number"]):
        draws = [*group]
        first, named = draws[0], [r for r in draws if r["right"]]
        values = [f"{extreme(r['value'] for r in named):.4g}" for extreme in (min, max)] if named else ["-"]
        others = Counter(
            f"`{r['verdict']}`: {', '.join(r['effects']) or 'nothing'}" for r in draws if not r["right"]
        )
        rows.append((
            f"`{first['key']}`", first["by"].replace("x", "times "), f"{first['nominal']:.4g}",
            f"{first['true']:.4g}", f"{len(named)} of {len(draws)}", " to ".join(dict.fromkeys(values)),
            "; ".join(f"{told} ({count})" for told, count in others.most_common()) or "-",
        ))  # fmt: skip
    return table(("parameter", "off by", "model", "true", "within 5 %", "found", "other answers"), rows)


def gap_outside() -> str:
    """Return what became of effects outside the catalogue."""
    cases = [case for file in sorted(RESULTS.glob("gap_outside_*.jsonl")) for case in gap_table.read(file)]
    newest = chosen_of(blind_set(LATEST_OUTSIDE), "outside")
    cases, rows = [*cases, *newest], []
    for effect, signals in gap_table.DEPENDS.items():
        chosen = [case for case in cases if case["effects"] == [effect]]
        right = [case for case in chosen if gap_table.told_rightly(case)]
        shares = [sum(share for _, share in case["found"]["described"]) for case in right]
        others = Counter(_told(case) for case in chosen if case not in right)
        latest = [case in right for case in chosen if case in newest]
        over = ", ".join(signals).replace("_", " ") or "no signal of the instant"
        rows.append((
            f"`{effect}`", over, str(len(chosen)),
            str(len(right)), f"{median(shares):.0%}" if any(shares) else "-",
            ", ".join(f"{name} {count}" for name, count in others.most_common()) or "-",
            f"{sum(latest)} of {len(latest)}",
        ))  # fmt: skip
    heads = ("hidden", "depends on", "cases", "told so", "removes", "other answers")
    return table((*heads, "told so, by the present rules"), rows)


def _told(case: dict[str, Any]) -> str:
    """Return a verdict, with the signals of a description or the names of effects."""
    found = case["found"]
    told = [name for name, _ in found["described"]] or gap_table.names(case)
    shown = ", ".join(told).replace("_", " ")
    return f"`{found['verdict']}`" + (f" ({shown})" if shown else "")


def gap_fuzz() -> str:
    """Return what became of recordings of other apparatus."""
    cases = [case for file in sorted(RESULTS.glob("gap_fuzz*.jsonl")) for case in gap_table.read(file)]
    rows = []
    for kind in dict.fromkeys(case["kind"] for case in cases):
        chosen = [case for case in cases if case["kind"] == kind]
        counts = Counter(case.get("verdict", "failed") for case in chosen)
        named = sum(bool(case.get("effects")) for case in chosen)
        words = ", ".join(f"`{name}` {n}" for name, n in counts.most_common())
        rows.append((kind, str(len(chosen)), words, str(named)))
    return table(("the apparatus", "cases", "verdict", "with a name"), rows)


def gap_own() -> str:
    """Return what the search names of the shipped hardware in the graph's own runs."""
    own = json.loads((RESULTS / "gap_own.json").read_text(encoding="utf-8"))
    rows = [
        (
            f"`{one['effect']}`, {one['quantity'].replace('_', ' ')}",
            f"{one['there']:.3g} {one['unit']}",
            "not named" if one["found"] is None else f"{one['found']:.3g} {one['unit']}",
        )
        for one in own["there"]
    ]
    others = sorted(set(own["named"]) - {one["effect"] for one in own["there"]})
    rows.append(("named beside", "", ", ".join(f"`{name}`" for name in others) or "nothing"))
    rows.append(("verdict; time on two idle cores", "", f"`{own['verdict']}`; {own['seconds']:.0f} s"))
    return table(("of the shipped hardware", "there", "found"), rows)


def gap_ankle() -> str:
    """Return what became of what was hidden in ankle and shoe."""
    rows = [
        (
            r["machine"] + (", worn" if r["person"] else ""),
            _hidden(r),
            ", ".join(_named(one) for one in r.get("effects", ())) or "nothing",
            f"`{r['verdict']}`" if "verdict" in r else "failed",
        )
        for name in ("gap_ankle", "gap_leg")
        for r in gap_table.read(RESULTS / f"{name}.jsonl")
    ]
    return table(("machine", "hidden", "named", "verdict"), rows)


def device_table() -> str:
    """Return how knees, ankles and soles of the device follow, with nobody and with persons."""
    columns = "in it", "knees", "ankles", "peak of a sole's force", "its time", "soles released"
    return table(columns, device.table(gap_table.read(RESULTS / "device.jsonl")))


def _hidden(result: dict[str, Any]) -> str:
    if "true" not in result:
        return f"`{result['hidden']}`"
    sizes = [v if isinstance(v, float) else next(iter(v.values())) for v in result["true"].values()]
    return f"`{result['hidden']}` {sizes[0]:.3g}" if sizes else "nothing"


def _named(effect: dict[str, Any]) -> str:
    return f"`{effect['name']}` {next(iter(effect['parameters'].values()))['value']:.3g}"


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({part / max(whole, 1):.0%})"


def gap_peer() -> str:
    """Return the same cases solved by the workflow and by PySINDy."""
    cases, peer = (gap_table.read(RESULTS / f"gap_{name}_626262.jsonl") for name in ("blind", "peer"))
    lines = gap_table.beside(cases, peer).splitlines()
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    short = [(f"{kind}, {size} ({number})", method, *rest) for kind, size, number, method, *rest in rows]
    return table(("cases", "method", *head[4:]), short)


def control() -> str:
    """Return median and largest maximum error of each controller over the drawn specimens."""
    drawn = drawn_runs()
    rows = [(task, *_errors(r for r in drawn if r["case"] == task)) for task in TASKS]
    rows.append(("all tasks", *_errors(drawn)))
    return table(("task", *(f"`{LABELS.get(name, name)}`" for name in CONTROLLERS)), rows)


def drawn_runs() -> list[dict[str, Any]]:
    """Return the runs of all controllers with drawn specimens; specimen 0 is the shipped hardware."""
    return [r for r in _lines(RESULTS / "control.jsonl") if r.get("specimen") and "max_deg" in r]


def _errors(runs: Iterable[dict[str, Any]]) -> list[str]:
    listed = list(runs)
    cells = []
    for controller in CONTROLLERS:
        errors = [r["max_deg"] for r in listed if r["controller"] == controller]
        above = sum(error > BOUND for error in errors)
        cells.append(
            f"{median(errors):.2f} / {max(errors):.2f} deg; {above} of {len(errors)} above 3 deg"
            if errors
            else "-"
        )
    return cells


def peers() -> str:
    """Return what each law by name does on the drawn specimens: tracking, effort, push, block."""
    drawn = drawn_runs()
    rows = []
    for name in ("paper", *PEERS):
        own = {
            task: [r for r in drawn if (r["case"], r["controller"]) == (task, name)] for task in PEER_TASKS
        }
        walks = [r for task in (TASKS[0], TASKS[2]) for r in own[task]]
        rows.append((
            f"`{'backstepping' if name == 'paper' else name}`",
            *(_median_and_worst(own[task], "max_deg", 2) for task in (TASKS[0], TASKS[2])),
            f"{sum(r['max_deg'] > BOUND for r in walks)} of {len(walks)}",
            *(_median_and_worst(own[task], "variation_v_per_s", 0) for task in (TASKS[0], TASKS[2])),
            _median_and_worst(own["push"], "stiffness", 0),
            _median_and_worst(own["block"], "felt", 0),
            _median_and_worst(own["block"], "speed_after", 1),
        ))  # fmt: skip
    return table(PEER_HEAD, rows)


def _median_and_worst(runs: Sequence[dict[str, Any]], key: str, digits: int) -> str:
    values = [r[key] for r in runs]
    return f"{median(values):.{digits}f} / {max(values):.{digits}f}" if values else "-"


def delay() -> str:
    """Return the worst maximum error of each cascade and wearer on other hardware."""
    runs = delay_rows()
    named = list(dict.fromkeys(r["hardware"] for r in runs))
    rows = [
        (name.replace("believed", "nominal"), *(_worst(runs, name, *column) for column in DELAY_COLUMNS))
        for name in named
    ]
    heads = (f"{CASCADES.get(cascade, cascade)}, {wearer}" for cascade, wearer in DELAY_COLUMNS)
    return table(("hardware", *heads), rows)


def delay_rows() -> list[dict[str, Any]]:
    """Return the runs on hardware that differs from the nominal model."""
    return _lines(RESULTS / "delay_study.jsonl")


def _worst(runs: Iterable[dict[str, Any]], hardware: str, cascade: str, wearer: str) -> str:
    keys = hardware, cascade, wearer
    errors = [r["maximum"] for r in runs if (r["hardware"], r["cascade"], r["wearer"]) == keys]
    return f"{max(errors):.2f} deg ({len(errors)})" if errors else "-"


def improve(scenario: str) -> str:
    """Return the table of a run of `improve`."""
    return improvement.table(json.loads((RESULTS / f"improve-{scenario}.json").read_text(encoding="utf-8")))


def speed() -> str:
    """Return what was measured beside what."""
    rows = [as_text(row)[:4] for row in speed_rows().values()]
    return table(("measured", "pam_orthosis", "beside it", "ratio"), rows)


def speed_rows() -> dict[str, dict[str, Any]]:
    """Return the measured rows of `SPEED`; KeyError if the results lack one."""
    measured = json.loads((RESULTS / "speed.json").read_text(encoding="utf-8"))
    rows = {}
    for group, wanted in SPEED.items():
        by_name = {row["what"]: row for row in measured[group]["rows"]}
        rows |= {what: by_name[what] for what in wanted}
    return rows


def paper() -> str:
    """Return the paper's results beside ours."""
    rows = [tuple(row.values()) for row in paper_results()["rows"]]
    return table(("result", "paper", "here", "how measured"), rows)


def paper_observer() -> str:
    """Return what less lag of the observer costs."""
    head = ("damping", "poles", "lag", "velocity noise", "gait, maximum", "gait, RMS", "voltage variation")
    return table(head, [
        (
            f"{one['damping']:g}", f"{one['pole']:g} /s", f"{one['lag'] * 1e3:.1f} ms",
            f"{57.29578 * one['velocity_noise']:.2f} deg/s", f"{one['max_error_deg']:.2f} deg",
            f"{one['rms_error_deg']:.3f} deg", f"{one['voltage_variation']:.0f} V/s",
        )
        for one in paper_results()["trade_off"]
    ])  # fmt: skip


def _listed(one: tables.Listed) -> str:
    return f"## {one.title}\n\n{one.words}\n\n{table(one.head, one.rows)}"


def paper_results() -> dict[str, Any]:
    """Return what `pam-orthosis paper --json` has found."""
    return json.loads((RESULTS / "paper.json").read_text(encoding="utf-8"))


def _lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines() if line]
