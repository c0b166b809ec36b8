# SPDX-License-Identifier: Apache-2.0
"""Blind cases of the gap workflow, counted: what was hidden against what was named."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

# effect outside the catalogue -> the measured signals that it depends on
DEPENDS = {
    "cogging_torque": ("angle",),
    "detent": ("angle",),
    "quadratic_drag": ("velocity",),
    "jet_torque": ("extensor_voltage",),
    "drifting_valve_gain": ("time",),
    "valve_cross_talk": ("extensor_voltage", "flexor_voltage"),
    "leak_across": ("extensor_pressure", "flexor_pressure"),
    "sticking_spool": (),
    "random_pushes": (),
    "wandering_torque": (),
}
SETS = ("clean", "realistic", "clean-none", "realistic-none", "pairs", "outside", "alone")
SIZES = ("small", "medium", "large")
OUTCOMES = ("right", "set", "extra", "wrong", "none", "failed")
OPEN = ("unexplained", "partial", "described")  # verdicts on a gap that is not explained
KEPT = ("verdict", "effects", "look_alikes", "closure", "gap_before", "rounds")
CLOSED = 0.95
DETECTABLE = 15.0  # evidence, at most, of what is hidden (`gap.evidence.threshold`)


def read(path: Path) -> list[dict]:
    """Return the cases of a results file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def which(case: dict) -> tuple:
    """Return what separates a case from all others of its seed."""
    return case["set"], case["seed"], *case["effects"]


def work_off(todo: list[dict], limit: int | None, solve, out: Path, line) -> None:
    """Solve cases one by one and append each result to a file; `line` puts a result into words."""
    tools: dict = {}
    for number, case in enumerate(todo[:limit]):
        try:
            result = solve(case, tools)
        except Exception as error:  # one failed case must not end a night's run; the table counts it
            result = {**case, "failed": f"{type(error).__name__}: {error}"}
        with open(out, "a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")
        print(f"{number + 1}/{len(todo)}", line(result), flush=True)


def keep(results: Iterable[dict], path: Path) -> None:
    """Write what the tables need of each case."""
    lines = []
    for result in results:
        short = dict(result)
        if "found" in short:
            found = {key: short["found"][key] for key in KEPT if key in short["found"]}
            found["described"] = short["found"].get("described") or described(short["found"])
            found["rounds"] = [{**r, "ranking": r["ranking"][:3]} for r in found["rounds"]]
            short["found"] = found
        lines.append(json.dumps(short))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def described(found: dict) -> list[tuple[str, float]]:
    """Return the signals over which a search describes what is unknown, each with the share it removes."""
    unknown = found.get("unknown") or {}
    curves = [unknown.get("curve"), *unknown.get("other_curves", ())]
    return [(one["coordinate"], one["reduced"]) for one in curves if one]


def told_rightly(result: dict) -> bool:
    """Whether it is said what an effect outside the catalogue depends on, and nothing else; or on nothing."""
    depends = set(DEPENDS[result["effects"][0]])
    if not depends:
        return result["found"]["verdict"] == "unexplained" and not result["found"]["described"]
    if result["found"]["verdict"] != "described":
        return False
    return {name for name, _ in result["found"]["described"]} <= depends


def judged(result: dict) -> str:
    """Return what became of a case with one effect: one of `OUTCOMES`."""
    if "failed" in result:
        return "failed"
    named = names(result)
    truth = set(result["effects"])
    if not named:
        return "none"
    if set(named) == truth:
        return "right"
    alike = {*named[:1], *result["found"]["look_alikes"]}
    if len(named) == 1 and len(alike) <= 2 and truth & alike:
        return "set"
    return "extra" if truth & set(named) else "wrong"


def too_small(result: dict) -> bool:
    """Whether a case got no name, and its recordings hold less evidence than a search asks for."""
    return judged(result) == "none" and result.get("at_most", DETECTABLE) < DETECTABLE


def falsely_explained(result: dict) -> bool:
    """Whether a gap is called explained by an effect that is not hidden."""
    if "found" not in result or result["found"]["verdict"] != "explained" or judged(result) == "set":
        return False
    return not set(names(result)) <= set(result["effects"]) or result["outside"]


def right_names(results: list[dict]) -> tuple[int, int]:
    """Return how many of the names that were given are right, and how many were."""
    given = [(name, r) for r in results if "found" in r for name in names(r)]
    return sum(_right_name(name, r) for name, r in given), len(given)


def closed(results: list[dict]) -> tuple[int, int]:
    """Return in how many of the gaps called explained at least `CLOSED` of the gap is, and how many were."""
    shares = [
        r["found"]["closure"]["overall"]
        for r in results
        if "found" in r and r["found"]["verdict"] == "explained"
    ]
    return sum(share is not None and share >= CLOSED for share in shares), len(shares)


def held(results: list[dict]) -> tuple[int, int]:
    """Return how many intervals of effects of the same form hold the truth, and how many there are."""
    _, inside = _parameters([r for r in results if judged(r) in ("right", "set")])
    return sum(inside), len(inside)


def names(result: dict) -> list[str]:
    """Return the names that were given."""
    return [effect["name"] for effect in result["found"]["effects"]]


def table(results: list[dict]) -> str:
    """Return the tables of some cases as Markdown."""
    solved = [r for r in results if "found" in r]
    parts = [_counts(results), _shares(solved), _confusion(solved), _none(solved), _others(results)]
    return "\n\n".join(part for part in parts if part)


def _of(results, name: str) -> list[dict]:
    return [r for r in results if r["set"] == name]


def _counts(results) -> str:
    heads = "right | set of 2 | with extras | wrong | not found | failed"
    lines = [f"| set | size | cases | {heads} | found |", "|" + "---|" * 10]
    for name in ("clean", "realistic"):
        for size in SIZES:
            chosen = [r for r in _of(results, name) if r["size"] == size]
            if chosen:
                count = Counter(judged(r) for r in chosen)
                cells = " | ".join(str(count[k]) for k in OUTCOMES)
                share = (count["right"] + count["set"]) / len(chosen)
                lines.append(f"| {name} | {size} | {len(chosen)} | {cells} | {share:.0%} |")
    return "\n".join(lines) if len(lines) > 2 else ""


def _shares(solved) -> str:
    lines = ["| | " + " | ".join(("clean", "realistic")) + " |", "|---|---|---|"]
    columns = [_figures(_of(solved, name)) for name in ("clean", "realistic")]
    for key in columns[0] | columns[1]:
        lines.append(f"| {key} | " + " | ".join(column.get(key, "-") for column in columns) + " |")
    return "\n".join(lines) if len(lines) > 2 else ""


def _figures(solved) -> dict[str, str]:
    """Return the figures of one class by their names."""
    if not solved:
        return {}
    good, given = right_names(solved)
    right = [r for r in solved if judged(r) in ("right", "set")]
    with_name = [r for r in solved if names(r)]
    closures = [r["found"]["closure"]["overall"] for r in right]
    closures = np.array([c for c in closures if c is not None])
    errors, inside = _parameters(right)
    flagged = sum(r["found"]["verdict"] in OPEN for r in right)
    seconds = [r["seconds"] for r in solved]
    return {
        "names given that are right": f"{good} of {given} ({good / max(given, 1):.0%})",
        "cases with a name, all of them right": f"{len(right)} of {len(with_name)}",
        "closure of rightly named cases, median": f"{np.median(closures):.3f}",
        f"closure at least {CLOSED}": f"{np.sum(closures >= CLOSED)} of {len(closures)}"
        f" ({np.mean(closures >= CLOSED):.0%})",
        "error of the size, median": f"{_quantile(errors, 0.5)} ({len(errors)} cases)",
        "error of the size, 90 % below": _quantile(errors, 0.9),
        "95 % intervals that hold the truth (same form)": f"{sum(inside)} of {len(inside)}",
        "named rightly, but called unexplained": f"{flagged} of {len(right)}",
        "time a case, median and longest": f"{np.median(seconds):.0f} s, {max(seconds):.0f} s",
    }


def _quantile(values: list[float], share: float) -> str:
    return f"{np.quantile(values, share):.1%}" if values else "-"


def _right_name(name: str, result: dict) -> bool:
    """Whether a name is right: hidden, or one of a set of two of which the other is."""
    return name in result["effects"] or judged(result) == "set"


def _parameters(right) -> tuple[list[float], list[bool]]:
    errors, inside = [], []
    for r in right:
        error, contained = _parameter(r)
        if error is not None:
            errors.append(error)
            if next(iter(r["answer"]["same_form"].values())):
                inside.append(contained)
    return errors, inside


def _parameter(result: dict):
    """Return the relative error of the size and whether the interval holds it; None for shapes."""
    (name, truth), *_ = result["answer"]["effects"].items()
    found = next((e for e in result["found"]["effects"] if e["name"] == name), None)
    if found is None or not isinstance(truth, dict):
        return None, None
    key = next((k for k in truth if k in found["parameters"]), None)
    if key is None:
        return None, None
    from pam_orthosis.testing.effects import EFFECTS

    neutral = 1.0 if EFFECTS[name].around_one else 0.0
    value, (low, high) = found["parameters"][key]["value"], found["parameters"][key]["interval"]
    return abs(value - truth[key]) / abs(truth[key] - neutral), low <= truth[key] <= high


def _confusion(solved) -> str:
    """Return all that lies off the diagonal of the confusion matrix."""
    cells = Counter()
    for r in solved:
        if r["set"] in ("clean", "realistic") and judged(r) != "right":
            named = " + ".join(names(r)) or "nothing"
            alike = "".join(f" or {name}" for name in r["found"]["look_alikes"]) if names(r) else ""
            cells[(r["set"], r["size"], r["effects"][0], named + alike)] += 1
    lines = ["| set | size | hidden | named | cases |", "|---|---|---|---|---|"]
    order = sorted(cells, key=lambda c: (c[0], SIZES.index(c[1]), c[3] == "nothing", c[2]))
    lines += [f"| {' | '.join(cell)} | {cells[cell]} |" for cell in order]
    return "\n".join(lines) if cells else ""


def _none(solved) -> str:
    lines = []
    for name in ("clean-none", "realistic-none"):
        chosen = _of(solved, name)
        if chosen:
            alarms = sum(r["found"]["verdict"] != "none" for r in chosen)
            named = sum(bool(names(r)) for r in chosen)
            lines.append(f"- {name}: {len(chosen)} cases, {named} with a name, {alarms} not `none`")
    return "\n".join(lines)


def _others(results) -> str:
    lines = []
    pairs = _of(results, "pairs")
    if pairs:
        both = sum("found" in r and set(r["effects"]) <= set(names(r)) for r in pairs)
        exact = sum(judged(r) == "right" for r in pairs)
        lines.append(f"- pairs: {len(pairs)} cases, both named {both}, and nothing else {exact}")
        lines += _of_detectable(results, pairs)
    outside = _of(results, "outside")
    if outside:
        honest = sum("found" in r and _honest(r["found"]) for r in outside)
        lines.append(
            f"- outside the catalogue: {len(outside)} cases, {honest} unexplained or closure below 50 %"
        )
    failed = sum("failed" in r for r in (*pairs, *outside))
    if failed:
        lines.append(f"- of pairs and outside, {failed} ended with an error")
    return "\n".join(lines)


def _of_detectable(results, pairs) -> list[str]:
    """Return how many pairs were named of those whose effects were each found alone."""
    singles = _of(results, "alone")
    if singles:
        found = Counter(r["seed"] for r in singles if judged(r) in ("right", "set"))
        shown, what = [r for r in pairs if found[r["seed"]] == 2], "in which each was found alone, the same"
        what += " but for the other"
    else:
        alone = _found_alone(results)
        shown, what = [r for r in pairs if set(r["effects"]) <= alone], "of effects that were found alone"
    both = sum("found" in r and set(r["effects"]) <= set(names(r)) for r in shown)
    return [f"- of these, {len(shown)} {what}: both named {both}"] if shown else []


def _found_alone(results) -> set[str]:
    """Return the effects that were found in the class `clean` at medium size, the size of the pairs."""
    alone = [r for r in _of(results, "clean") if r["size"] == "medium"]
    return {r["effects"][0] for r in alone if judged(r) in ("right", "set")}


def _honest(found: dict) -> bool:
    share = found["closure"]["overall"]
    return found["verdict"] in OPEN or share is None or share < 0.5


def beside(results: list[dict], peer: list[dict]) -> str:
    """Return the table of this workflow and of PySINDy over the cases that both have solved."""
    theirs = {(r["set"], r["seed"]): r for r in peer}
    pairs = [(r, theirs[r["set"], r["seed"]]) for r in results if (r["set"], r["seed"]) in theirs]
    heads = "right | set of 2 | with extras | wrong | no name | first name right"
    lines = [f"| set | size | cases | method | {heads} |", "|" + "---|" * 10]
    for name, size in sorted({(r["set"], r["size"]) for r, _ in pairs}):
        chosen = [pair for pair in pairs if (pair[0]["set"], pair[0]["size"]) == (name, size)]
        for method, which in (("gap", 0), ("PySINDy", 1)):
            count = Counter(outcome(pair[which]) for pair in chosen)
            first = sum(_first(pair[which]) in pair[0]["effects"] for pair in chosen)
            cells = [*(count[kind] for kind in OUTCOMES[:-1]), first]
            lines.append(f"| {name} | {size} | {len(chosen)} | {method} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def outcome(result: dict) -> str:
    """Return `judged`, but any name is wrong where nothing, or nothing of the catalogue, was hidden."""
    kind = judged(result)
    if kind not in ("none", "failed") and (result["outside"] or not result["effects"]):
        return "wrong"
    return kind


def _first(result: dict) -> str | None:
    """Return the name with the most evidence, or the largest coefficient."""
    named = names(result) if "found" in result else []
    return named[0] if named else None
