# SPDX-License-Identifier: Apache-2.0
"""The tables of `faults.md`, from what the campaigns of `benchmarks/faults.py` found."""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from generators.markdown import table

DOCS = Path(__file__).resolve().parents[1]
Told = Mapping[str, Any]


def pages() -> dict[str, str]:
    """Return the page with each block between its two markers made anew."""
    text = (DOCS / "faults.md").read_text(encoding="utf-8")
    results = json.loads((DOCS / "studies" / "faults.json").read_text(encoding="utf-8"))
    for name, make in ((name, BLOCKS[name]) for name in results):
        pattern = rf"<!-- {name} -->.*?<!-- /{name} -->"
        block = f"<!-- {name} -->\n\n{make(results[name])}\n<!-- /{name} -->"
        text = re.sub(pattern, lambda _, block=block: block, text, flags=re.S)
    return {"faults.md": text}


def _head(told: Told, what: str) -> str:
    return f"`--count {told['count']} --seed {told['seed']}`: {what}\n\n"


def _input(told: Told) -> str:
    counted = ("tried", "refused", "judged", "tracebacks", "hangs", "other_faults")
    rows = [(kind, *(str(each[key]) for key in counted)) for kind, each in told["kinds"].items()]
    total = [str(sum(each[key] for each in told["kinds"].values())) for key in counted]
    head = ("input", "tried", "refused", "answered", "tracebacks", "hangs", "other faults")
    return _head(told, f"{total[0]} inputs.") + table(head, [*rows, ("**all**", *total)])


def _signals(told: Told) -> str:
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
        for name, each in told["faults"].items()
    ]
    head = ("fault", "of", "tried", "reaction", "pressure, bar", "knee, degrees", "bad voltages", "wrong")
    tried = sum(each["tried"] for each in told["faults"].values())
    return _head(told, f"{tried} runs, {told['wrong']} with anything wrong.") + table(head, rows)


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{word} {count}" for word, count in sorted(counts.items()))


def _guards(told: Told) -> str:
    rows = [
        (
            f"{guard} taken out",
            fault,
            f"{len(each['wrong'])} of {each['tried']}",
            "; ".join(each["wrong"]) or "-",
        )
        for guard, faults in told["removed"].items()
        for fault, each in faults.items()
    ]
    return table(("broken on purpose", "fault", "runs found wrong", "what the campaign says"), rows)


def _kills(told: Told) -> str:
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
        for name, each in told["kills"].items()
    ]
    head = (
        "run", "fault", "tried", "ended within 2 s", "median, s", "longest, s", "data lost, ms at most",
        "valves at the vent", "wrong",
    )  # fmt: skip
    tried = sum(each["tried"] for each in told["kills"].values())
    in_time = sum(each["in_time"] for each in told["kills"].values())
    said = (
        f"{tried} faults, {in_time} runs ended within 2 s, load average {told['load_average']} on two cores."
    )
    return _head(told, said) + table(head, rows)


def _soak(told: Told) -> str:
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
    return table(("figure", "value"), [(units[key], str(told[key])) for key in units if key in told])


BLOCKS: dict[str, Callable[[Told], str]] = {
    "input": _input,
    "signals": _signals,
    "guards": _guards,
    "kills": _kills,
    "soak": _soak,
}
