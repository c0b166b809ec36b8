# SPDX-License-Identifier: Apache-2.0
"""The pictures of figs. 8 and 9 and of the observer's trade-off."""

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.report.paper.observer import DAMPING, PATTERNS, POLE, ObserverRun, TradeOff
from pam_orthosis.report.paper.tracking import Tracking

DPI = 110
TRUE, ESTIMATED = "0.6", "tab:red"
COLOURS = dict(zip(PATTERNS, ("tab:blue", "tab:orange"), strict=True))
SHOWN = 7.0  # s of fig. 8
PAPER_LAG, LAG_BOUND, ERROR_BOUND = 25.0, 20.0, 3.0  # ms, ms, deg


def draw_observer(run: ObserverRun, file: BinaryIO) -> None:
    """Draw angle, velocity and disturbance, true and estimated."""
    s, time = run.signals, run.signals["time"]
    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    rows = (
        ("angle / deg", time, np.degrees(s["true_angle"]), np.degrees(s["estimate_angle"])),
        ("velocity / deg/s", time, np.degrees(s["true_velocity"]), np.degrees(s["estimate_velocity"])),
        ("disturbance / N m", run.disturbance_time, run.disturbance, s["disturbance"]),
    )
    for ax, (label, instants, true, estimated) in zip(axes, rows, strict=True):
        ax.plot(instants, true, color=TRUE, lw=3, label="true")
        ax.plot(time, estimated, color=ESTIMATED, lw=0.9, label="estimated")
        ax.set_ylabel(label)
    p, tuned = run.parameters, run.parameters.flat()
    axes[0].legend(loc="lower right", ncols=2)
    axes[0].set_title(
        f"{p.plant.external_torque:g} N m at {p.plant.external_frequency:g} Hz, poles at {tuned[POLE]:g} /s,"
        f" damping {tuned[DAMPING]:g}: the disturbance is estimated {run.lag * 1e3:.1f} ms late"
    )
    axes[-1].set(xlabel="time / s", xlim=(0, SHOWN))
    figure.savefig(file, dpi=DPI)


def draw_trade_off(points: Sequence[TradeOff], chosen: ObserverRun, file: BinaryIO) -> None:
    """Draw noise, valve activity and tracking error over the lag, for each pattern of the poles."""
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    panels = (
        ("noise of the velocity / rad/s", lambda one: one.velocity_noise),
        ("gait: variation of the voltage / V/s", lambda one: one.voltage_variation),
        ("gait: RMS error / deg", lambda one: one.rms_error_deg),
    )
    axes = figure.subplots(1, 3)
    for ax, (label, value) in zip(axes, panels, strict=True):
        for damping, name in PATTERNS.items():
            line = [one for one in points if one.damping == damping]
            lags = [one.lag * 1e3 for one in line]
            ax.plot(lags, [value(one) for one in line], "o-", color=COLOURS[damping], label=name)
            for one, lag in zip(line, lags, strict=True):
                ax.annotate(f"{one.pole:g}", (lag, value(one)), xytext=(4, 4), textcoords="offset points",
                            fontsize=7)  # fmt: skip
        ax.axvline(PAPER_LAG, color="0.5", ls=":", label="paper")
        ax.axvline(LAG_BOUND, color="k", ls="--", label="bound")
        ax.set(xlabel="lag of the disturbance / ms", ylabel=label, ylim=(0, None))
    axes[0].plot(chosen.lag * 1e3, chosen.velocity_noise, "k*", ms=12, label="fig. 8 here")
    axes[0].legend(fontsize=8)
    figure.suptitle("what less lag costs; the numbers are the poles' distance from zero in 1/s")
    figure.savefig(file, dpi=DPI)


def draw_tracking(found: Tracking, file: BinaryIO) -> None:
    """Draw angle and error over time on the left and over the gait cycle on the right."""
    figure = Figure(figsize=(12, 6), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row", width_ratios=(3, 2))
    _draw(axes[:, 0], found.time, found)
    whole = np.arange(np.ceil(np.nanmin(found.phase)), np.floor(np.nanmax(found.phase) + 1e-9))
    for number in whole:
        cycle = np.flatnonzero((found.phase >= number) & (found.phase < number + 1))
        _draw(axes[:, 1], 100 * (found.phase - number), found, cycle)
    for ax in axes[1]:
        for sign in (-1, 1):
            ax.axhline(sign * ERROR_BOUND, color="k", ls="--", lw=1)
    axes[0, 0].legend(loc="upper left", ncols=2)
    axes[0, 0].set_ylabel("knee angle / deg")
    axes[1, 0].set(ylabel="error / deg", xlabel="time / s")
    axes[1, 1].set(xlabel="gait cycle / % from heel strike", xlim=(0, 100))
    axes[0, 1].set_title(f"{len(whole)} cycles over each other")
    figure.savefig(file, dpi=DPI)


def _draw(axes, x, found: Tracking, part=slice(None)) -> None:
    axes[0].plot(x[part], found.reference[part], color=TRUE, lw=3, label="reference")
    axes[0].plot(x[part], found.angle[part], color=ESTIMATED, lw=0.9, label="measured")
    axes[1].plot(x[part], found.error[part], color=ESTIMATED, lw=0.8)
