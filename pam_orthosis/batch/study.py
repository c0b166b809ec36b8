# SPDX-License-Identifier: Apache-2.0
"""A parameter study: which sets of parameters and seeds the closed loop is to walk with.

A file in YAML: `scenario`, `set` (parameters of all), and whose combinations are walked with: `seeds`, `sets`
(a list of parameter sets), `grid` (parameter -> values), `random` (`count`, `seed`, `between`: parameter ->
[low, high]).
"""

from collections.abc import Iterator, Mapping
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.reading import read_yaml, shown

KINDS = {"scenario": str, "set": dict, "seeds": list, "sets": list, "grid": dict, "random": dict}
DRAWN = {"count", "seed", "between"}


def read_study(path: Path) -> list[dict[str, Any]]:
    """Return the overrides of each walk, seed among them; OrthosisError for an entry no walk can have."""
    study = read_yaml(path)
    if not isinstance(study, dict) or not study or set(study) - set(KINDS):
        raise OrthosisError(f"{path}: a study has entries of {', '.join(KINDS)}, and no others")
    for name, value in study.items():
        if not isinstance(value, KINDS[name]):
            raise OrthosisError(f"{path}: {name} is not a {KINDS[name].__name__}")
    common = {**scenario_overrides(study.get("scenario", "default")), **study.get("set", {})}
    walks = [{**common, **one} for one in _combined(path, study)]
    for number, walk in enumerate(walks):
        with naming(f"{path}: walk {number}"):
            load(walk)
    return walks


def _combined(path: Path, study: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    _check_parts(path, study)
    _check_count(path, study)
    seeds = [{"scenario.seed": seed} for seed in study.get("seeds", [])] or [{}]
    grid = study.get("grid", {})
    crossed = [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
    drawn = list(_drawn(path, study["random"])) if "random" in study else [{}]
    for parts in product(study.get("sets", []) or [{}], crossed, drawn, seeds):
        yield {key: value for part in parts for key, value in part.items()}


def _check_parts(path: Path, study: Mapping[str, Any]) -> None:
    """Check grid and sets."""
    grid = study.get("grid", {})
    if not all(isinstance(key, str) and isinstance(values, list) and values for key, values in grid.items()):
        raise OrthosisError(f"{path}: grid gives each parameter a list of values")
    between = study.get("random", {}).get("between")
    if isinstance(between, dict) and (both := [key for key in grid if key in between]):
        raise OrthosisError(f"{path}: {both[0]} is in grid and in random; leave it in one of them")
    if not all(isinstance(one, dict) for one in study.get("sets", [])):
        raise OrthosisError(f"{path}: sets is a list of parameter sets")


def _check_count(path: Path, study: Mapping[str, Any]) -> None:
    """Check how many walks the combinations come to, before one is made."""
    lists = [study.get("seeds", []), study.get("sets", []), *study.get("grid", {}).values()]
    draws, count = study.get("random", {}).get("count", 1), prod(max(1, len(one)) for one in lists)
    count *= draws if isinstance(draws, int) else 1
    most_walks = 100_000  # of a study: each is a process, and a folder of results
    if count > most_walks:
        raise OrthosisError(f"{path}: {shown(count)} walks, more than {most_walks}: give parts of it")


def _drawn(path: Path, study: Mapping[str, Any]) -> Iterator[dict[str, float]]:
    """Yield parameter sets, each value uniform between its bounds."""
    try:
        count, seed, between = study["count"], study.get("seed", 0), study["between"]
        low, high = np.array([between[key] for key in between], dtype=float).reshape(-1, 2).T
        whole = isinstance(count, int) and isinstance(seed, int) and count >= 1 and seed >= 0
        with np.errstate(over="ignore"):  # which is judged
            ordered = np.isfinite(high - low).all() and (low <= high).all()
        if not whole or not between or set(study) - DRAWN or not ordered:
            raise ValueError
    except (KeyError, TypeError, ValueError, AttributeError):
        words = "count (1 or more), seed (0 or more) and between: parameter -> [low, high]"
        raise OrthosisError(f"{path}: random has {words}") from None
    for values in np.random.default_rng(seed).uniform(low, high, (count, len(low))).tolist():
        yield dict(zip(between, values, strict=True))
