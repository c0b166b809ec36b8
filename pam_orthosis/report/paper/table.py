# SPDX-License-Identifier: Apache-2.0
"""The table paper / here / how measured, and the page around it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.tracking import REST_SECONDS, rms
from pam_orthosis.identification.identify import Identified
from pam_orthosis.identification.samples import Samples
from pam_orthosis.report.paper.by_hand import Moved
from pam_orthosis.report.paper.drawings import SCHEMES
from pam_orthosis.report.paper.force_rate import ForceRate
from pam_orthosis.report.paper.inertia import Compared
from pam_orthosis.report.paper.observer import DAMPING, POLE, ObserverRun, TradeOff
from pam_orthosis.report.paper.tracking import BRISK, Tracking

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
WAY = 5.0e-3  # m after a change in direction
Data = Sequence[Mapping[str, Any]]


class Listed(NamedTuple):
    """A table: its title, words below that, its head and its rows."""

    title: str
    words: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


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
        data: dict[str, Any] = {
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
    results = markdown(("result", "paper", "here", "how measured"), rows(found))
    parts = [_HEAD, results, "\n", _words(found.observer), _trade_off(found.trade_off)]
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
    head = "damping", "poles", "lag", "velocity noise", "gait: maximum", "gait: RMS", "voltage variation"
    return markdown(head, [
        (
            f"{one.damping:g}", f"{one.pole:g} /s", f"{one.lag * 1e3:.1f} ms",
            f"{np.degrees(one.velocity_noise):.2f} deg/s", f"{one.max_error_deg:.2f} deg",
            f"{one.rms_error_deg:.3f} deg", f"{one.voltage_variation:.0f} V/s",
        )
        for one in points
    ])  # fmt: skip


def errors_by_turn(found: Identified) -> tuple[float, float]:
    """Return the RMS error of the force model within `WAY` after a change in direction, and elsewhere, N.

    At the held-out pressures; NaN where there is no such sample.
    """
    s = found.held_out
    residual, after = found.force.model.residual(s), after_turns(s)
    near, far = (rms(part) if len(part) else np.nan
                 for part in (residual[after], residual[~after]))  # fmt: skip
    return near, far


def after_turns(s: Samples) -> np.ndarray:
    """Return which samples are within `WAY` after a change in direction of their run."""
    after = np.zeros(len(s), dtype=bool)
    for serial in np.unique(s.serial[s.serial >= 0]):
        rows = np.flatnonzero(s.serial == serial)
        ways = np.maximum.accumulate(np.where(s.direction[rows] != 0, np.arange(len(rows)), 0))
        way = s.direction[rows][ways]  # of the last motion, where it rests
        turns = np.flatnonzero(np.diff(way) * way[1:] * way[:-1] != 0) + 1
        last = np.zeros(len(rows), dtype=int)
        last[turns] = turns
        last = np.maximum.accumulate(last)
        moved = np.abs(s.contraction[rows] - s.contraction[rows][last])
        after[rows] = (last > 0) & (moved <= WAY)
    return after


def tables(data: Mapping[str, Any]) -> list[Listed]:
    """Return the tables of the page."""
    return [by_hand(data["by_hand"]), force_rate(data["force_rate"]), inertia(data["inertia"])]


def by_hand(moved: Data) -> Listed:
    """Return what it takes to move the joints by hand."""
    head = (
        "joint", "motion", "torque of the hand", "weight alone", "inertia alone", "friction and muscles",
        "the same, muscles filled",
    )  # fmt: skip
    rows = [
        (
            f"{one['joint']}, {'with a person' if one['person'] else 'no person'}",
            f"{one['speed']}, {one['from_deg']:.0f} to {one['to_deg']:.0f} deg,"
            f" up to {one['speed_deg_s']:.0f} deg/s",
            *(f"{one[kind]:.2f} N m" for kind in ("torque", "weight", "inertia", "resistance")),
            f"{one['filled']:.1f} N m",
        )
        for one in moved
    ]  # fmt: skip
    return Listed(
        "Moved by hand when depressurised",
        "A hand leads the joint of the emulated hardware while all valves vent; the largest of each torque."
        " Weight holds the passive moment of a relaxed person's joint. Filled: valves closed,"
        " muscles at their mean pressure.",
        head,
        rows,
    )


def force_rate(compared: Data) -> Listed:
    """Return what the choice for the derivative of the specimen's force makes of the rig."""
    head = (
        "derivative of the force", "noise at rest, less the true one", "lag", "RMS error of the derivative",
        "RMS force that the carriage misses", "largest position error",
    )  # fmt: skip
    rows = [
        (
            one["choice"], f"{one['noise']:.0f} N/s",
            "-" if one["lag"] is None else f"{1e3 * one['lag']:.0f} ms",
            f"{one['rate_error']:.0f} N/s", f"{one['force_error']:.2f} N",
            f"{1e3 * one['position_error']:.3f} mm",
        )
        for one in compared
    ]  # fmt: skip
    return Listed(
        "Derivative of the specimen's force at the rig",
        "Eq. (10) neglects it, and the paper names a disturbance observer as an alternative:"
        " `rig.position.force_rate`. The procedure of section 2.5 at 4 bar.",
        head,
        rows,
    )


def inertia(compared: Data) -> Listed:
    """Return the person's inertia by radii of gyration and by solids."""
    head = ("quantity", "De Leva", "frustum, cylinder", "difference")
    rows = [
        (
            one["quantity"], f"{one['gyration']:.4g} {one['unit']}", f"{one['solids']:.4g} {one['unit']}",
            f"{100 * (one['solids'] / one['gyration'] - 1):+.1f} %",
        )
        for one in compared
    ]  # fmt: skip
    return Listed(
        "The person's inertia",
        "The paper models the thigh as a frustum and the shank as a cylinder; `leg.person.inertia` chooses."
        " Person of 75 kg and 1.75 m.",
        head,
        rows,
    )
