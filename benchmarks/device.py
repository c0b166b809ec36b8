# SPDX-License-Identifier: Apache-2.0
"""The whole device, recorded by `run --machine device` and judged by `check`, alone and with persons.

    python benchmarks/device.py [--out benchmarks/results/device.jsonl]

Resumable: what the results file holds already is not run again.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from gap_table import read, work_off

RESULTS = Path(__file__).resolve().parent / "results" / "device.jsonl"
HELD = {"volition.enabled": True, "block.start": 4.4, "block.duration": 1.5, "block.damping": 1.0}
CLONUS = {
    f"tissue.clonus.{key}": one for key, one in {"enabled": True, "amplitude": 4.0, "threshold": 1.0}.items()
}
PUSH = {"ankle/plant.external_torque": 5.0, "ankle/plant.external_frequency": 0.35}


def of_ankles(rows: dict) -> dict:
    """Return parameters of the person at both ankles."""
    return {f"ankle/plant.person.{key}": value for key, value in rows.items()}


# who, seconds, parameters
CASES = (
    ("nobody", 20, {}),
    ("a person of 75 kg", 20, {}),
    ("pushes the feet with 5 N m", 10, PUSH),
    ("holds the ankles with 150 N m/rad for 1.5 s", 10, of_ankles({**HELD, "block.stiffness": 150.0})),
    ("holds the ankles with 1000 N m/rad for 1.5 s", 10, of_ankles({**HELD, "block.stiffness": 1000.0})),
    ("has a clonus of 4 N m, 6 Hz", 10, of_ankles(CLONUS)),
)


def solve(case: dict, _tools: dict) -> dict:
    """Record and judge a case."""
    name, seconds, rows = next(one for one in CASES if one[0] == case["who"])
    given = {"leg.person.present": name != "nobody", **rows}
    words = [word for key, value in given.items() for word in ("--param", f"{key}={json.dumps(value)}")]
    with tempfile.TemporaryDirectory() as folder:
        run = ["run", "--machine", "device", "--composed", "--duration", str(seconds), "--json"]
        run += ["--out", f"{folder}/bag", "--bound-deg", "1", *words]
        told = subprocess.run(["pam-orthosis", *run], capture_output=True, check=False)
    return {**case, "seconds": seconds, "joints": dict(map(_short, json.loads(told.stdout)["legs"].items()))}


def _short(entry: tuple[str, dict]) -> tuple[str, dict]:
    name, verdict = entry
    kept = "max_abs_error_deg", "passed", "loads", "releases", "not_led"
    return name, {key: verdict[key] for key in kept if key in verdict}


def table(results: list[dict]) -> list[tuple[str, ...]]:
    """Return who, largest errors of knees and ankles, and how far the soles' forces are off."""
    return [
        (one["who"], *(_largest(one, kind) for kind in ("knee", "ankle")), *_soles(one)) for one in results
    ]


def _largest(result: dict, kind: str) -> str:
    joints = (verdict for name, verdict in result["joints"].items() if name.endswith(kind))
    return f"{max(one['max_abs_error_deg'] for one in joints):.2f} deg"


def _soles(result: dict) -> tuple[str, ...]:
    joints = result["joints"]
    loads = [one for verdict in joints.values() for one in verdict.get("loads", {}).values()]
    off = max(abs(one["peak_N"] / one["set_peak_N"] - 1) for one in loads)
    late = max(abs(one["late_ms"] or 0.0) for one in loads)
    times = sum(len(verdict["releases"]) for name, verdict in joints.items() if name.endswith("shoe"))
    return ("-", "-", str(times)) if times else (f"{off:.1%}", f"{late:.1f} ms", "0")


def main() -> None:
    """Solve the cases that the results file does not hold yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    out = parser.parse_args().out
    known = [one["who"] for one in read(out)] if out.exists() else []
    work_off([{"who": one[0]} for one in CASES if one[0] not in known], None, solve, out, str)


if __name__ == "__main__":
    main()
