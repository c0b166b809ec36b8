# SPDX-License-Identifier: Apache-2.0
"""What is hidden in a leg, joint by joint: recorded by `run --machine leg`, searched by `gap --namespace`.

    python benchmarks/gap_leg.py [--out benchmarks/results/gap_leg.jsonl]

The emulated hardware has the effects below and no others; masses, forces, valves and gas deviate from the
nominal model as they do in any run, damping within its tolerance. Resumable.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

from gap_table import read, work_off

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.model.device import device_named

RESULTS = Path(__file__).resolve().parent / "results" / "gap_leg.jsonl"
SECONDS, SEEDS = 24, (1, 2)
OWN = {
    "plant.muscle_law": "polynomial", "valve.dead_band": 0.0, "valve.delay": 0.0,
    "plant.deviation.muscle_damping": 0.9, "plant.deviation.small_muscle_damping": 0.9,
    **{f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")},
}  # fmt: skip
# joint, effect, its first parameter and the size of that
EFFECTS = (
    ("ankle", "joint_friction", "coulomb", 0.5),
    ("knee", "extensor_leak", "coefficient", 1.0e-10),
)
CASES = [{"joint": joint, "both": both} for both in (True, False) for joint in ("knee", "ankle")]


def changes(hidden: bool) -> dict:
    """Return the parameters of a leg with the effects hidden, or without any."""
    found = dict(OWN)
    for name, one in device_parameters(device_named(Path("leg")), {}).items():
        on = (key for key, value in one.flat().items() if key.endswith(".enabled") and value is True)
        found |= {f"{name}/{key}": False for key in on if key.startswith("plant.effects.")}
    for joint, effect, parameter, size in EFFECTS if hidden else ():
        found |= {f"{joint}/plant.effects.{effect}.{k}": v for k, v in (("enabled", True), (parameter, size))}
    return found


def record(hidden: bool, folder: Path) -> list[Path]:
    """Return two bags of a leg."""
    bags = [folder / f"{'two' if hidden else 'none'}-{seed}" for seed in SEEDS]
    given = [
        word for key, value in changes(hidden).items() for word in ("--param", f"{key}={json.dumps(value)}")
    ]
    run = ["pam-orthosis", "run", "--machine", "leg", "--composed", "--duration", str(SECONDS)]
    for seed, bag in zip(SEEDS, bags, strict=True):
        told = [*run, "--seed", str(seed), "--out", str(bag), *given, "--bound-deg", "10"]
        subprocess.run(told, check=True, capture_output=True)
    return bags


def solve(case: dict, known: dict) -> dict:
    """Search a joint, and return what was named beside what was hidden."""
    folder = known.setdefault("folder", tempfile.TemporaryDirectory())
    if case["both"] not in known:
        known[case["both"]] = record(case["both"], Path(folder.name))
    training, held_out = known[case["both"]]
    start = time.monotonic()
    given = [str(training), "--held-out", str(held_out), "--namespace", case["joint"], "--json"]
    told = json.loads(
        subprocess.run(["pam-orthosis", "gap", *given], capture_output=True, check=False).stdout
    )
    true = {e: {p: size} for joint, e, p, size in EFFECTS if case["both"] and joint == case["joint"]}
    return {
        "machine": f"{case['joint']} of a leg",
        "person": False,
        **case,
        "hidden": next(iter(true), ""),
        "true": true,
        **{key: told[key] for key in ("verdict", "effects", "runner_up", "closure")},
        "right": [one["name"] for one in told["effects"]] == list(true),
        "seconds": round(time.monotonic() - start, 1),
    }


def main() -> None:
    """Solve the cases that the results file does not hold yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    out = parser.parse_args().out
    known = [(one["joint"], one["both"]) for one in read(out)] if out.exists() else []
    todo = [case for case in CASES if (case["joint"], case["both"]) not in known]
    work_off(
        todo, None, solve, out, lambda one: f"{one.get('machine')}: {one.get('verdict')} {one.get('right')}"
    )


if __name__ == "__main__":
    main()
