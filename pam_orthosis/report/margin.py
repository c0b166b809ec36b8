# SPDX-License-Identifier: Apache-2.0
"""Margins of the closed loop: table, plots and page, from what `batch.margin.measure` returns."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from pam_orthosis.report.page import NEUTRAL, Page, Part, listed
from pam_orthosis.report.plots import AFTER, BEFORE, Plot, dots, line

HEAD = ("perturbation", "unit", "nominal", "error doubles", "{} is lost")


def table(found: Mapping[str, Any]) -> str:
    """Return the table in Markdown, what its limits mean, and what was left out."""
    rows = [
        tuple(name.format(found["machine"]) for name in HEAD),
        *(cells(row) for row in found["margins"]),
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [_line(row, widths) for row in rows]
    lines.insert(1, "|".join(["", *("-" * (width + 2) for width in widths), ""]))
    return "\n".join([*lines, "", *notes(found)])


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    return "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"


def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a perturbation in one direction."""
    name = f"{row['perturbation']}, {row['direction']}"
    return name, row["unit"], f"{row['nominal']:.3g}", _limit(row, "doubled"), _limit(row, "lost")


def _limit(row: Mapping[str, Any], which: str) -> str:
    """Return the values between which a limit is reached, or up to where nothing happens."""
    if row["end"] == row["nominal"]:
        return "at its bound"
    kept, reached = row[which]["kept"], row[which]["reached"]
    if reached is None:
        return f"{'>' if row['direction'] == 'more' else '<'} {row['end']:.3g}"
    return f"{kept:.3g} .. {reached:.3g}"


def notes(found: Mapping[str, Any]) -> list[str]:
    """Return what the limits mean, and what was left out."""
    unit = found["error_unit"]
    error, doubled, lost = (found[f"{key}_{unit}"] for key in ("max_abs_error", "doubled", "lost"))
    notes = [
        f"Maximum error on the hardware as it is: {error:.2f} {unit}. Doubled: {doubled:.2f} {unit}."
        f" Lost: beyond {lost:.1f} {unit}, or a guard vents.",
        f"Runs of {found['duration_s']:g} s, seed {found['seed']}. Each limit lies between two values.",
    ]
    return notes + [f"Not in this hardware: {name}." for name in found["not_there"]]


def _runs(
    rows: Sequence[Mapping[str, Any]], unit: str
) -> tuple[tuple[Sequence[float], Sequence[float]], list[float]]:
    """Return rising values and their maximum errors, and the values at which the machine is lost."""
    runs = {run["value"]: run[f"max_abs_error_{unit}"] for row in rows for run in row["runs"]}
    values, sizes = zip(*sorted(one for one in runs.items() if one[1] is not None), strict=True)
    return (values, sizes), [value for value, error in runs.items() if error is None]


def page(found: Mapping[str, Any]) -> str:
    """Return the page of what `batch.margin.measure` found."""
    lost = [row for row in found["margins"] if row["lost"]["reached"] is not None]
    names = sorted({f"{row['direction']} {row['perturbation']}" for row in lost})
    tried = f"of {len(found['margins'])} changes"
    headline = (
        f"The {found['machine']} is lost by {len(names)} {tried}: {', '.join(names)}."
        if names
        else f"None {tried} loses the {found['machine']}."
    )
    head = [name.format(found["machine"]) for name in HEAD]
    rows = [cells(row) for row in found["margins"]]
    parts = [
        Part("Limits", table=listed(head, rows)),
        Part("Error against each change", ("The controllers stay as they are.",), plots=plots(found)),
    ]
    return Page(
        "margin", "measured", NEUTRAL, headline, notes(found), parts, "margins of the closed loop"
    ).html()


def plots(found: Mapping[str, Any]) -> list[Plot]:
    """Return the maximum error against each perturbation."""
    groups = groupby(found["margins"], lambda row: row["perturbation"])
    return [_plot(found, name, list(rows)) for name, rows in groups]


def _plot(found: Mapping[str, Any], name: str, rows: Sequence[Mapping[str, Any]]) -> Plot:
    unit = found["error_unit"]
    doubled, beyond = found[f"doubled_{unit}"], found[f"lost_{unit}"]
    (values, sizes), gone = _runs(rows, unit)
    data = [line(values, sizes, "maximum error", AFTER) | {"mode": "lines+markers"}]
    if gone:
        data.append(dots(gone, [beyond] * len(gone), f"{found['machine']} lost", BEFORE, 9.0, "x"))
    alt = f"maximum error from {min(sizes):.2f} to {max(sizes):.2f} {unit}; lost at {len(gone)} values"
    title = f"{name}: nominal {rows[0]['nominal']:.3g} {rows[0]['unit']}; dashed: error doubled, and lost"
    return Plot(
        title, alt, f"{name} / {rows[0]['unit']}", f"error / {unit}", data, (doubled, beyond), log=True
    )
