# SPDX-License-Identifier: Apache-2.0
"""The table paper / here / how measured, and the page around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.tracking import REST_SECONDS
from pam_orthosis.identification.identify import Identified
from pam_orthosis.report.paper.by_hand import Moved
from pam_orthosis.report.paper.force_rate import ForceRate
from pam_orthosis.report.paper.inertia import Compared
from pam_orthosis.report.paper.observer import DAMPING, POLE, ObserverRun, TradeOff
from pam_orthosis.report.paper.schemes import SCHEMES
from pam_orthosis.report.paper.tables import tables
from pam_orthosis.report.paper.tracking import BRISK, Tracking
from pam_orthosis.report.paper.turns import WAY, errors_by_turn

PICTURES = {
    "force": "Fig. 4: force, measured and calculated",
    "volume": "Fig. 5: volume, measuring points and model",
    "observer": "Fig. 8: observer under a sinusoidal disturbance",
    "trade_off": "What less lag costs",
    "tracking": "Fig. 9: tracking and error over the gait",
} | SCHEMES
_HEAD = """# The paper's results, side by side

`pam-orthosis paper` writes this page, tables and pictures, from runs that it makes itself.

"""


class Row(NamedTuple):
    """One result: the paper's own figure, ours, and how ours was measured."""

    result: str
    paper: str
    here: str
    how: str


@dataclass(frozen=True)
class Results:
    """What the figures' runs gave.

    `observer` is the paper's simulation (the plant is the observer's model), `observer_on_hardware` the
    same on the emulated hardware. `by_hand` is each joint with its muscles vented, and filled.
    """

    identified: Identified
    observer: ObserverRun
    observer_on_hardware: ObserverRun
    trade_off: Sequence[TradeOff]
    tracking: Tracking
    by_hand: Sequence[tuple[Moved, Moved]]
    force_rate: Sequence[ForceRate]
    inertia: Sequence[Compared]

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as plain data for JSON; SI units, angles in degrees."""
        data = {
            "rows": [row._asdict() for row in rows(self)],
            "force_error": {
                "held_out": self.identified.errors(held_out=True),
                "training": self.identified.errors(held_out=False),
            },
            "trade_off": [asdict(one) for one in self.trade_off],
            "by_hand": [
                vented.as_dict() | {"filled": filled.as_dict()["resistance"]}
                for vented, filled in self.by_hand
            ],
            "force_rate": [asdict(one) for one in self.force_rate],
            "inertia": [one._asdict() for one in self.inertia],
        }
        for name in ("observer", "observer_on_hardware"):
            run = getattr(self, name)
            data[name] = {key: getattr(run, key) for key in ("lag", "gain", "velocity_noise")}
        data["tracking"] = {
            key: getattr(self.tracking, key) for key in ("largest", "rms", "worst_phase", "accelerated")
        }
        data["tracking"] |= {key: getattr(self.tracking, key).tolist() for key in ("beginnings", "rests")}
        return data


def rows(found: Results) -> list[Row]:
    """Return the table's rows."""
    return [*_force_rows(found.identified), *observer_rows(found), *tracking_rows(found.tracking)]


def page(found: Results) -> str:
    """Return the page in Markdown; pictures lie beside it in `pictures/`."""
    parts = [_HEAD, _table(rows(found)), "\n", _words(found.observer), _trade_off(found.trade_off)]
    for one in tables(found.as_dict()):
        parts.append(f"\n## {one.title}\n\n{one.words}\n\n{markdown(one.head, one.rows)}")
    parts += [f"\n## {title}\n\n![{title}](pictures/{name}.png)\n" for name, title in PICTURES.items()]
    return "".join(parts)


def observer_rows(found: Results) -> list[Row]:
    """Return the rows of fig. 8."""
    run, hardware = found.observer, found.observer_on_hardware
    return [
        Row(
            "lag of the estimated disturbance", "about 25 ms", f"{run.lag * 1e3:.1f} ms",
            "phase of the estimate against the true torque at its frequency; plant = the observer's model, "
            "as in the paper's simulation, sensors noisy",
        ),
        Row(
            "the same on the emulated hardware", "-", f"{hardware.lag * 1e3:.1f} ms",
            "against the torque that is missing in Eq. (26) to explain the true motion: friction, hysteresis "
            "and misfit of the muscles included",
        ),
        Row(
            "amplitude of the estimate / true", "-", f"{run.gain:.3f}", "at the same frequency",
        ),
        Row(
            "noise of the estimated velocity", "-", f"{np.degrees(run.velocity_noise):.2f} deg/s",
            "standard deviation of estimate - truth without its harmonics",
        ),
    ]  # fmt: skip


def tracking_rows(found: Tracking) -> list[Row]:
    """Return the rows of fig. 9."""
    return [
        Row(
            "maximum tracking error", "about 3 deg, in the swing phase",
            f"{found.largest:.2f} deg, at {100 * found.worst_phase:.0f} % of the cycle",
            f"reference - measured angle, emulated hardware, no person, "
            f"{found.parameters.scenario.cycle_time:g} s a cycle, start included",
        ),
        Row(
            "the same during the largest acceleration", "the largest", f"{found.accelerated:.2f} deg",
            f"the largest error in those {100 * BRISK:g} % of the time in which the reference accelerates or"
            " decelerates most, at full cadence",
        ),
        Row(
            "steady-state error at the beginning of the step", "below 1 deg", _over_steps(found.beginnings),
            f"mean absolute error in the {REST_SECONDS:g} s about the instant, nearest to heel strike, when"
            f" the knee turns, of {len(found.beginnings)} gait steps",
        ),
        Row(
            "the same, steps from rest to rest", "-", _over_steps(found.rests),
            f"in the last {REST_SECONDS:g} s before each of {len(found.rests)} steps of the scenario `steps`",
        ),
        Row("RMS tracking error", "-", f"{found.rms:.3f} deg", "the same run"),
    ]  # fmt: skip


def _over_steps(errors: np.ndarray) -> str:
    return f"{errors.max():.3f} deg at most, {errors.mean():.3f} deg mean"


def _force_rows(found: Identified) -> list[Row]:
    errors = found.errors(held_out=True)
    near, far = errors_by_turn(found)
    levels = ", ".join(f"{float(one):.1f}" for one in errors["by_pressure_bar_gauge"])
    rows = [
        Row(
            "force model, DMSP-20", "about 30 N maximum",
            f"{errors['max']:.1f} N maximum, {errors['rms']:.1f} N RMS",
            f"emulated rig, at {levels} bar gauge, which the fit did not see; RMS {near:.1f} N within"
            f" {1e3 * WAY:g} mm after a change in direction, {far:.1f} N elsewhere",
        )
    ]  # fmt: skip
    if found.volume:
        v = found.volume
        here = f"{v.largest * 1e6:.2f} cm³ maximum, {v.rms * 1e6:.2f} cm³ RMS"
        rows.append(Row("volume model, DMSP-20", "-", here, "at the measuring points"))
    return rows


def _table(lines: Sequence[Row]) -> str:
    return markdown(("result", "paper", "here", "how measured"), lines)


def markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *lines))


def _words(run: ObserverRun) -> str:
    p, tuned = run.parameters, run.parameters.flat()
    sensor = p.plant.sensor
    late = (1 + 2 * tuned[DAMPING]) / tuned[POLE]
    return f"""
Fig. 8: the knee follows a sine of {np.degrees(p.scenario.sine.amplitude):.0f} degrees at
{1 / p.scenario.cycle_time:g} Hz under {p.plant.external_torque:g} N m at {p.plant.external_frequency:g} Hz
(scenario `observer`). The observer's poles lie {tuned[POLE]:g} /s from zero, one real and a pair of damping
{tuned[DAMPING]:g}; a slow disturbance is then estimated (1 + 2 x {tuned[DAMPING]:g}) / {tuned[POLE]:g} s =
{1e3 * late:.1f} ms late. Sensors: angle noise {np.degrees(sensor.angle_noise):.3f} degrees RMS and step
{np.degrees(sensor.angle_resolution):.3f} degrees, pressure noise {sensor.pressure_noise / 100:.1f} mbar RMS
and step {sensor.pressure_resolution / 100:.1f} mbar, every {1e3 * p.scenario.control_period:g} ms. Each value
of the torque acts for one period; it counts as that of the period's middle.

## Lag against noise

The gait runs with the same observer, emulated hardware, default gains.

"""


def _trade_off(points: Sequence[TradeOff]) -> str:
    head = (
        "| damping | poles | lag | velocity noise | gait: maximum | gait: RMS | voltage variation |\n"
        "|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(
        f"| {one.damping:g} | {one.pole:g} /s | {one.lag * 1e3:.1f} ms"
        f" | {np.degrees(one.velocity_noise):.2f} deg/s | {one.max_error_deg:.2f} deg"
        f" | {one.rms_error_deg:.3f} deg | {one.voltage_variation:.0f} V/s |\n"
        for one in points
    )
