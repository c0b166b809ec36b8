# SPDX-License-Identifier: Apache-2.0
"""Tables of what the campaigns of `benchmarks/faults.py` found."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from generators.markdown import table

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results" / "faults.json"
RETURNS, MODBUS = RESULTS.with_name("returns.json"), RESULTS.with_name("modbus.json")
Found = Mapping[str, Any]


def blocks() -> dict[str, Callable[[], str]]:
    """Return the tables by their names."""
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    made = {
        f"faults-{name}": lambda name=name: MAKERS[name](results[name]) for name in results if name in MAKERS
    }
    rows = {"faults-returns": (_returns, RETURNS), "modbus": (_modbus, MODBUS)}
    return made | {
        name: lambda make=make, file=file: make(json.loads(file.read_text(encoding="utf-8")))
        for name, (make, file) in rows.items()
    }


def _head(what: str) -> str:
    return f"{what}\n\n"


def _input(found: Found) -> str:
    counted = ("tried", "refused", "judged", "tracebacks", "hangs", "other_faults")
    rows = [(kind, *(str(each[key]) for key in counted)) for kind, each in found["kinds"].items()]
    total = [str(sum(each[key] for each in found["kinds"].values())) for key in counted]
    head = ("input", "tried", "refused", "answered", "tracebacks", "hangs", "other faults")
    return _head(f"{total[0]} inputs.") + table(head, [*rows, ("**all**", *total)])


def _signals(found: Found) -> str:
    rows = [
        (
            name,
            ", ".join(each["targets"]),
            str(each["tried"]),
            _counted(each["reactions"]),
            f"{each['highest_pressure_bar']:.2f}",
            f"{each['angle_deg'][0]:.1f} .. {each['angle_deg'][1]:.1f}",
            str(each["bad_voltages"]),
            "; ".join(each["wrong"]) or "-",
        )
        for name, each in found["faults"].items()
    ]
    head = ("fault", "of", "tried", "reaction", "pressure, bar", "knee, degrees", "bad voltages", "wrong")
    tried = sum(each["tried"] for each in found["faults"].values())
    return _head(f"{tried} runs, {found['wrong']} with anything wrong.") + table(head, rows)


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{word} {count}" for word, count in sorted(counts.items()))


def _guards(found: Found) -> str:
    rows = [
        (
            f"{guard} taken out",
            fault,
            f"{len(each['wrong'])} of {each['tried']}",
            "; ".join(each["wrong"]) or "-",
        )
        for guard, faults in found["removed"].items()
        for fault, each in faults.items()
    ]
    return table(("broken on purpose", "fault", "runs found wrong", "what the campaign says"), rows)


def _kills(found: Found) -> str:
    rows = [
        (
            name.split(", ", 1)[0],
            name.split(", ", 1)[1],
            str(each["tried"]),
            f"{each['in_time']} of {each['tried']}",
            f"{each['median_s']:.2f}",
            f"{each['longest_s']:.2f}",
            f"{each['lost_ms']:.0f}",
            f"{each['vented']} of {each['asked_to_vent']}" if each["asked_to_vent"] else "-",
            "; ".join(each["wrong"]) or "-",
        )
        for name, each in found["kills"].items()
    ]
    head = (
        "run", "fault", "tried", "ended within 2 s", "median, s", "longest, s", "data lost, ms at most",
        "valves at the vent", "wrong",
    )  # fmt: skip
    tried = sum(each["tried"] for each in found["kills"].values())
    in_time = sum(each["in_time"] for each in found["kills"].values())
    said = (
        f"{tried} faults, {in_time} runs ended within 2 s, load average {found['load_average']} on two cores."
    )
    return _head(said) + table(head, rows)


def _returns(rows: list[Found]) -> str:
    """Return who left and came again in which way, and how the knee followed afterwards."""
    lines = []
    for mode, lockstep in (("real time", False), ("lockstep", True)):
        of_mode = [row for row in rows if row["lockstep"] is lockstep]
        for who in dict.fromkeys(row["who"] for row in of_mode):
            own = [row for row in of_mode if row["who"] == who]
            away, left = (max(row[key] for row in own) for key in ("released_deg", "left_deg"))
            longest = max(row["seconds"] for row in own)
            faults = "; ".join(fault for row in own for fault in row["faults"]) or "-"
            lines.append((mode, who, str(len(own)), f"{longest:g}", f"{away:.1f}", f"{left:.1f}", faults))
    head = ("run", "who", "tried", "away, s at most", "error meanwhile, deg", "error then, deg", "wrong")
    return table(head, lines)


def _modbus(rows: list[Found]) -> str:
    """Return how fast the example of a driver answers, and how the knee follows before and after a loss."""
    lines = [
        (
            str(number),
            f"{row['latency_median_ms']:.2f}",
            f"{row['latency_p99_ms']:.2f}",
            " of ".join(str(row[key] - row["skipped_samples"]) for key in ("missed_deadlines", "periods")),
            str(row["skipped_samples"]),
            f"{row['error_before_deg']:.2f}",
            "-" if row["error_after_deg"] is None else f"{row['error_after_deg']:.2f}",
        )
        for number, row in enumerate(rows, 1)
    ]
    head = (
        "run", "latency, median, ms", "99 %, ms", "late answers", "samples not taken (400 while it was gone)",
        "largest error before, deg", "3 s after the return, deg",
    )  # fmt: skip
    return table(head, lines)


def _strangers(found: Found) -> str:
    rows = [
        (
            mode,
            str(each["tried"]),
            f"{each['in_time']} of {each['tried']}",
            "-" if each["longest_s"] is None else f"{each['longest_s']:.2f}",
            "; ".join(each["wrong"]) or "-",
        )
        for mode, each in found["strangers"].items()
    ]
    return table(("run", "tried", "ended within 2 s", "longest, s", "wrong"), rows)


def _soak(found: Found) -> str:
    units = {
        "seconds": "simulated, s",
        "wall_s": "took, s",
        "steps": "steps",
        "messages": "messages in the bag",
        "lost_messages": "messages missing",
        "lost_at_the_end_s": "lost when all processes were killed in the end, s",
        "close_s": "closing the bag then, s",
        "memory_start_mib": "memory of the nodes at the first look, MiB",
        "memory_end_mib": "at the end, MiB",
        "memory_growth_mib_per_hour": "growth, MiB in an hour of the run",
        "reference_drift_us": "drift of the reference's phase against the clock, us",
        "lag_drift_us": "change of the knee's lag behind it, us",
        "largest_error_first_minute_deg": "largest error in the first minute, degrees",
        "largest_error_last_minute_deg": "in the last minute, degrees",
    }
    return table(("figure", "value"), [(units[key], str(found[key])) for key in units if key in found])


MAKERS: dict[str, Callable[[Found], str]] = {
    "input": _input,
    "signals": _signals,
    "guards": _guards,
    "kills": _kills,
    "strangers": _strangers,
    "soak": _soak,
}
