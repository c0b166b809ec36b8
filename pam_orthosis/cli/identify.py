# SPDX-License-Identifier: Apache-2.0
"""Identify a muscle from bags of the test rig or from measured tables; write rows for config/."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.cli.check import not_negative
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import (
    Write,
    as_text,
    instead_of_out,
    output,
    refuse_existing,
    refuse_used,
    write_files,
)
from pam_orthosis.model.specimens import SPECIMENS
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    import numpy as np

    from pam_orthosis.identification.force import ForceFit
    from pam_orthosis.identification.identify import Identified

PAGE = "identify.html"
SHOWN = {"level": (1e-5, "bar gauge"), "length": (1e3, "mm"), "repeat": (1.0, "")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    data = "rig bags, .csv tables (columns such as p_Pa_gauge,L_m,F_N,slack), or folders of them"
    parser.add_argument("data", type=Path, nargs="+", metavar="DATA", help=data)
    muscle = (
        f"which muscle, {' or '.join(SPECIMENS)} (named by bags and file names), or of any other a YAML file"
        " with length and diameter in m"
    )
    parser.add_argument("--muscle", metavar="NAME|FILE", help=muscle)
    parser.add_argument(
        "--machine", type=Path, metavar="FILE", help="the muscles are those of this machine, and its values"
    )
    parser.add_argument(
        "--nominal-length-m", type=not_negative, metavar="M", help="nominal length of the muscle in a table"
    )
    parser.add_argument(
        "--held-out-bar", type=not_negative, nargs="*", metavar="P",
        help="absolute pressures that judge and are not fitted (rig.procedure.held_out_pressures)",
    )  # fmt: skip
    parser.add_argument(
        "--degrees",
        type=int,
        nargs=2,
        default=(3, 4),
        metavar=("A", "B"),
        help="degrees of the polynomials of Eq. (14) (3 4)",
    )
    parser.add_argument(
        "--damping",
        type=not_negative,
        metavar="D",
        help="damping in N s/m, instead of that of the decays",
    )
    parser.add_argument(
        "--out", type=output, metavar="FILE", help="write the rows, for --model or config/muscle.yaml"
    )
    parser.add_argument("--update", type=Path, metavar="FILE", help="put the rows into such a file")
    parser.add_argument(
        "--figures", type=output, metavar="DIR", help="draw force, residuals and volume, write a page"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Identify, write what was asked for, print the result."""
    if arguments.out:
        refuse_existing([arguments.out])
    if arguments.figures:
        with instead_of_out("--figures"):
            refuse_used(arguments.figures)
    if arguments.nominal_length_m == 0:
        raise OrthosisError("--nominal-length-m: a muscle is longer than 0 m")
    with shown("loading the identification") as progress:
        found = _identified(arguments, progress)
    print(json.dumps(found.as_dict(), indent=2) if arguments.json else describe(found))
    return 0


def _identified(arguments: argparse.Namespace, progress: Progress) -> Identified:
    """Identify, write what was asked for."""
    from pam_orthosis.identification import rows  # scipy takes a second to load
    from pam_orthosis.identification.asked import bench_and_muscle, check_degrees, held_out_gauge
    from pam_orthosis.identification.data import read_data
    from pam_orthosis.identification.identify import identify

    check_degrees(arguments.degrees)
    bench, muscle = bench_and_muscle(arguments.muscle, arguments.machine)
    length = arguments.nominal_length_m
    data = read_data(arguments.data, muscle, length, progress, bench)
    asked = arguments.held_out_bar
    held_out = held_out_gauge(data, None if asked is None else [bar * 1e5 for bar in asked])
    with naming(arguments.data[0] if len(arguments.data) == 1 else None):
        found = identify(data, held_out, tuple(arguments.degrees), arguments.damping, progress)
    rows.check(found)
    origin = "a measured table" if found.data.static else "the emulated test rig"
    source = f"identified on {origin} by `pam-orthosis identify`"
    written: dict[Path, Write] = {}
    edited = arguments.update and arguments.update.resolve()
    if edited:
        written[edited] = as_text(rows.updated(arguments.update, found, source))
    if arguments.out:
        written[arguments.out] = as_text(rows.as_yaml(found, source))
    if arguments.figures:
        progress("drawing the figures")
        from pam_orthosis.report.identification import drawn, page  # matplotlib takes its time to load

        made = {**drawn(found), PAGE: as_text(page(found, describe(found)))}
        written |= {arguments.figures / name: write for name, write in made.items()}
    write_files(written, {edited})
    return found


def describe(found: Identified) -> str:
    """Return the result as text."""
    from pam_orthosis.identification.identify import USUAL_MISFIT

    fit, box = found.force, found.box
    lines = [
        f"{_title(found)}, nominal length {found.data.length:g} m", *_values(found),
        f"rank {fit.rank} of {len(fit.half_width)}, condition {fit.condition:.3g} (unscaled"
        f" {fit.condition_raw:.3g}), {len(found.training)} samples{_worth(found)}",
        _intervals(fit), *_directions(found), *found.remarks,
        *_errors("fit", found.errors(held_out=False)), *_errors("held out", found.errors(held_out=True)),
    ]  # fmt: skip
    if found.hysteresis:
        h = found.hysteresis
        lines.append(
            f"hysteresis: {h.mean:.1f} N more in stretching or venting than the other way"
            f" ({h.low:.1f} .. {h.high:.1f} N by level)"
        )
    lines += _left_out(found)
    if found.data.own:
        lines.append(
            f"`sizes: {{force_map_misfit: {found.misfit_size:g}}}` of its actuators in a machine file says"
            f" to gap that this force may be off by {found.misfit_size:g} times the usual {USUAL_MISFIT:g} N"
        )
    first = min(box.minimum_contraction, float(found.training.contraction.min()))  # stretched, too
    lines.append(
        f"box of validity: contraction {first * 1e3:.1f} .."
        f" {box.maximum_contraction * 1e3:.1f} mm, up to {box.maximum_pressure_gauge / 1e5:.2f} bar"
        " gauge; do not extrapolate beyond its ends"
    )
    if not found.stiff:
        lines.append("caution: in the box the modelled force does not fall everywhere with the contraction")
    return "\n".join(lines)


def _title(found: Identified) -> str:
    own = f"a muscle of your own, in the place of {found.data.specimen}"
    return own if found.data.own else found.data.specimen


def _values(found: Identified) -> list[str]:
    """Return lines on the coefficients of force and volume and on the damping, and what is none of these."""
    model = found.force.model
    lines = _coefficients({"a": model.a, "b": model.b}, found.force.half_width, found.between)
    if found.damping:
        d = found.damping
        losses = f"dry friction apart (Eq. 18 counts all losses: {d.decrement:.1f}; T_d = {d.period:.3f} s)"
        if not d.apart:
            losses = f"all losses, Eq. 18 (T_d = {d.period:.3f} s); with F_N dry friction would be told apart"
        lines.append(f"  D = {d.value:.1f} +- {d.half_width:.1f} N s/m, {losses}")
    if found.given_damping is not None:
        lines.append(f"  D = {found.given_damping:g} N s/m was given, and counts")
    if found.volume:
        v = found.volume
        lines += _coefficients({"v": v.v}, v.half_width[: len(v.v)])
        lines += _coefficients({"w": v.w[1:]}, v.half_width[len(v.v) :], first=1)
        lines.append(
            f"  volume error {v.rms * 1e6:.2f} cm^3 RMS, {v.largest * 1e6:.2f} cm^3 maximum; +- of v and w:"
            " 95 %, if the rows are independent of each other"
        )
    if found.not_identified:
        lines.append(f"  {found.not_identified}")
    return lines


def _coefficients(
    named: Mapping[str, np.ndarray], half: np.ndarray, between: np.ndarray | None = None, first: int = 0
) -> list[str]:
    """Return a line for each coefficient: value, interval, and how far off both directions let it be."""
    names = [f"{name}_{i}" for name, own in named.items() for i in range(first, first + len(own))]
    beside = [""] * len(names) if between is None else [f", directions +- {one:.1e}" for one in between]
    values = [value for own in named.values() for value in own]
    return [
        f"  {name} = {value: .8e} +- {width:.1e}{more}"
        for name, value, width, more in zip(names, values, half, beside, strict=True)
    ]


def _errors(name: str, errors: dict[str, Any]) -> list[str]:
    if not errors:
        return []
    lines = [f"{name}: {errors['rms']:.2f} N RMS, {errors['max']:.2f} N maximum, {errors['samples']} samples"]
    for kind, unit in (("by_pressure_bar_gauge", " bar gauge"), ("by_direction", "")):
        if len(errors[kind]) > 12:  # the sum says enough
            continue
        lines += [
            f"  {key + unit:18s} {e['rms']:6.2f} RMS {e['max']:6.2f} max {e['mean']:+6.2f} mean"
            for key, e in errors[kind].items()
            if key != "rest"  # no direction: a few rows at turning points, or all
        ]
    return lines


def _worth(found: Identified) -> str:
    """Return what samples that follow each other in time are worth; empty for others."""
    worth = round(found.force.effective)
    return f": neighbours err alike, they are worth {worth}" if worth < len(found.training) else ""


def _intervals(fit: ForceFit) -> str:
    from pam_orthosis.identification.force import REPEATS

    if not fit.clustered:
        return "+-: 95 %, if the rows are independent of each other: give a column repeat, or direction"
    if fit.clustered == REPEATS:
        return f"+-: 95 % of further repeats lie in it, as {fit.clusters} of them show; the truth need not"
    return (
        f"+-: 95 %, by the scatter of {fit.clusters} runs; where a repeat of all would lie, three repeats"
        " show (column repeat)"
    )


def _directions(found: Identified) -> list[str]:
    """Return a line on what intervals do not hold, where data have both directions."""
    if found.between is None:
        return []
    wider = int((found.between > found.force.half_width).sum())
    return [
        "directions +-: so far a coefficient may be off, as the force at rest lies anywhere between both"
        f" directions (larger than +- in {wider} of {len(found.between)}); creep slower than a run adds to it"
    ]


def _left_out(found: Identified) -> list[str]:
    lines = []
    for kind, errors in found.left_out.items():
        lines.append(f"left out, one {kind} at a time:")
        known = [e for e in errors.values() if e]
        if len(errors) > 12 and known:
            worst = max(e[0] for e in known)
            middle = sorted(e[0] for e in known)[len(known) // 2]
            lines.append(f"  {len(errors)} of them: {middle:.1f} N RMS in the median, {worst:.1f} N at worst")
            continue
        factor, unit = SHOWN[kind]
        for at, e in errors.items():
            error = "not determined by the others" if e is None else f"{e[0]:6.1f} N RMS {e[1]:6.1f} N max"
            lines.append(f"  {at * factor:6.2f} {unit:9s} {error}")
    return lines
