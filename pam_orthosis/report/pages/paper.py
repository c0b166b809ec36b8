# SPDX-License-Identifier: Apache-2.0
"""The page of the paper's results: the table, and the figures computed again."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pam_orthosis.report.identification import force_plot
from pam_orthosis.report.page import NEUTRAL, Page, Part, Picture, listed
from pam_orthosis.report.paper.drawings import SCHEMES
from pam_orthosis.report.paper.observer import PATTERNS, ObserverRun, TradeOff
from pam_orthosis.report.paper.table import Results, rows, tables
from pam_orthosis.report.paper.tracking import Tracking
from pam_orthosis.report.plots import AFTER, BEFORE, ESTIMATE, MEASURED, REFERENCE, Plot, Trace, dots, line
from pam_orthosis.report.run_data import thinned

LOOKS = dict(zip(PATTERNS, ((AFTER, "solid"), (BEFORE, "dash")), strict=True))
LAG = "lag of the disturbance / ms"
CYCLE = "gait cycle / % from heel strike"
PANELS = {
    "velocity_noise": "noise of the velocity / rad/s",
    "voltage_variation": "gait: variation of the voltage / V/s",
    "rms_error_deg": "gait: RMS error / deg",
}


def page(found: Results, schematic: Mapping[str, bytes]) -> str:
    """Return the page; `schematic` are the figures that show no run, PNG by name."""
    headline = (
        f"Tracking: {found.tracking.largest:.2f} deg at most (paper: about 3 deg). Observer: the disturbance"
        f" is estimated {found.observer.lag * 1e3:.1f} ms late (paper: about 25 ms)."
    )
    meaning = [
        "The paper measured a device; here it is emulated. The table says how each figure was measured."
    ]
    head = ("result", "paper", "here", "how measured")
    parts = [
        Part("Side by side", table=listed(head, [tuple(row) for row in rows(found)])),
        Part("Fig. 4: force", plots=[force_plot(found.identified)]),
        Part("Fig. 8: observer under a sinusoidal disturbance", plots=observer_plots(found.observer)),
        Part("What less lag costs", plots=trade_off_plots(found.trade_off, found.observer)),
        Part("Fig. 9: tracking and error over the gait", plots=tracking_plots(found.tracking)),
        *(Part(one.title, (one.words,), listed(one.head, one.rows)) for one in tables(found.as_dict())),
        *(Part(SCHEMES[name], pictures=[Picture(SCHEMES[name], png)]) for name, png in schematic.items()),
    ]
    return Page(
        "paper", "side by side", NEUTRAL, headline, meaning, parts, "the paper's results again"
    ).html()


def _curve(x: Any, y: Any, *look: Any) -> Trace:
    return line(*thinned(np.asarray(x), np.asarray(y), most=1000), *look)


def observer_plots(run: ObserverRun) -> list[Plot]:
    """Return fig. 8: angle, velocity and disturbance, true and estimated."""
    s, time = run.signals, run.signals["time"]
    panels = {
        "angle / deg": (time, np.degrees(s["true_angle"]), np.degrees(s["estimate_angle"])),
        "velocity / deg/s": (time, np.degrees(s["true_velocity"]), np.degrees(s["estimate_velocity"])),
        "disturbance / N m": (run.disturbance_time, run.disturbance, s["disturbance"]),
    }
    return [
        Plot(f"{label.split(' / ')[0]}, true and estimated", f"{label} over time", "time / s", label, [
            _curve(instants, true, "true", REFERENCE, "dash", 2.2),
            _curve(time, estimated, "estimated", ESTIMATE),
        ], (), "fig. 8")
        for label, (instants, true, estimated) in panels.items()
    ]  # fmt: skip


def trade_off_plots(points: Sequence[TradeOff], chosen: ObserverRun) -> list[Plot]:
    """Return noise, valve activity and tracking error over the lag, for each pattern of the poles."""
    noise, variation, error = (_over_lag(points, kind, label) for kind, label in PANELS.items())
    noise.data.append(dots([chosen.lag * 1e3], [chosen.velocity_noise], "fig. 8 here", MEASURED, 12.0, "x"))
    return [noise, variation, error]


def _over_lag(points: Sequence[TradeOff], kind: str, label: str) -> Plot:
    most = max(getattr(one, kind) for one in points)
    curves = [
        _pattern([one for one in points if one.damping == damping], kind, name, *LOOKS[damping])
        for damping, name in PATTERNS.items()
    ]
    for name, lag, dash in (("paper", 25.0, "dot"), ("bound", 20.0, "dash")):
        curves.append(line([lag, lag], [0.0, most], name, REFERENCE, dash))
    title = f"{label.split(' / ', maxsplit=1)[0]}; the numbers are the poles' distance from zero, 1/s"
    return Plot(title, f"{label} over the lag of the disturbance", LAG, label, curves)


def _pattern(points: Sequence[TradeOff], kind: str, name: str, colour: str, dash: str) -> Trace:
    lags, values = [one.lag * 1e3 for one in points], [getattr(one, kind) for one in points]
    words = {"text": [f"{one.pole:g}" for one in points], "textposition": "top right"}
    return line(lags, values, name, colour, dash) | {"mode": "lines+markers+text"} | words


def tracking_plots(found: Tracking) -> list[Plot]:
    """Return fig. 9: angle and error, over the time and over the gait cycle."""
    error = f"error at most {found.largest:.2f} deg"
    alt = f"knee angle, reference and measured; {error}"
    return [
        plot
        for x, over, shared in (("time / s", _curve_of_time, "fig. 9"), (CYCLE, _curve_of_cycle, "cycle"))
        for plot in (
            Plot("Knee angle", f"{alt}, over {x}", x, "knee angle / deg", [
                over(found, found.reference, "reference", REFERENCE, "dash", 2.2),
                over(found, found.angle, "measured", MEASURED),
            ], (), shared),
            Plot("Error: reference less measured", f"{error}, over {x}", x, "error / deg",
                 [over(found, found.error, "error", MEASURED)], (3.0, -3.0), shared),
        )
    ]  # fmt: skip


def _curve_of_time(found: Tracking, value: np.ndarray, *look: Any) -> Trace:
    return _curve(found.time, value, *look)


def _curve_of_cycle(found: Tracking, value: np.ndarray, *look: Any) -> Trace:
    """Return the cycles over each other."""
    known = ~np.isnan(found.phase)
    phase, value = thinned(found.phase[known], value[known], most=1000)
    place, value = 100 * (phase % 1), value.copy()
    value[:-1][np.diff(place) < 0] = np.nan  # a cycle ends: no line leads back
    return line(place, value, *look)
