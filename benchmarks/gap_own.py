# SPDX-License-Identifier: Apache-2.0
"""The graph's own runs, searched: what of the shipped hardware does the gap workflow name?

    python benchmarks/gap_own.py [--out benchmarks/results/gap_own.json]

A gait and all diagnostic experiments are recorded by `run` as shipped, twice: to fit and to judge. The search
knows what the bags say. Minutes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pam_orthosis.model.parameters import load

RESULTS = Path(__file__).resolve().parent / "results" / "gap_own.json"
# bag -> arguments of `run`
RUNS = {
    "gait": ["--duration", "20"],
    "diagnostic": ["--scenario", "diagnostic"],
    "held_out_gait": ["--duration", "14", "--seed", "2"],
    "held_out_diagnostic": ["--scenario", "diagnostic", "--seed", "3"],
}
# what the shipped hardware has beside the model -> the key of its size
SIZES = {
    "valve_dead_band.half_width": "V",
    "joint_friction.coulomb": "N m",
    "muscle_hysteresis.half_width": "N",
    "viscous_friction.viscosity": "N m s/rad",
    "valve_lag.natural_frequency": "Hz",
    "extensor_pressure_delay.delay": "s",
    "flexor_pressure_delay.delay": "s",
}


def recorded(folder: Path) -> None:
    """Record all runs in a folder."""
    for name, arguments in RUNS.items():
        _called(["run", "--composed", *arguments, "--out", name], folder)


def searched(folder: Path) -> tuple[dict, float]:
    """Return what the search says, and how long it took, s."""
    start = time.monotonic()
    gait, diagnostic, *held_out = RUNS
    told = _called(["gap", gait, diagnostic, "--held-out", *held_out, "--json"], folder)
    return json.loads(told), time.monotonic() - start


def _called(arguments: list[str], folder: Path) -> str:
    """Return what a verb prints; it may say no."""
    command = [sys.executable, "-m", "pam_orthosis.cli.main", *arguments]
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode > 1:
        raise SystemExit(f"{' '.join(arguments)} ended with {done.returncode}")
    return done.stdout


def beside(found: dict) -> list[dict]:
    """Return what is there beside what was found; pressures are late by what they are behind the angle."""
    hardware = load()
    named = {one["name"]: one["parameters"] for one in found["effects"]}
    common = named.get("angle_delay", {}).get("delay", {}).get("value", 0.0)
    rows = []
    for key, unit in SIZES.items():
        effect, _, quantity = key.partition(".")
        size = named.get(effect, {}).get(quantity)
        behind = common if effect.endswith("pressure_delay") else 0.0
        row = {"effect": effect, "quantity": quantity, "unit": unit}
        there = float(hardware.at(f"plant.effects.{key}"))
        rows.append({**row, "there": there, "found": size and size["value"] - behind})
    return rows


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as folder:
        recorded(Path(folder))
        found, seconds = searched(Path(folder))
    result = {
        "verdict": found["verdict"],
        "named": [one["name"] for one in found["effects"]],
        "closure": found["closure"]["overall"],
        "seconds": round(seconds, 1),
        "there": beside(found),
    }
    out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
