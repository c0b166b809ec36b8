# SPDX-License-Identifier: Apache-2.0
"""The page of the paper's results: the table, and the figures computed again."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pam_orthosis.report.identification import force_plot
from pam_orthosis.report.page import NEUTRAL, Page, Part, Picture, listed
from pam_orthosis.report.paper.drawings import SCHEMES
from pam_orthosis.report.paper.observer import PATTERNS, ObserverRun, TradeOff
from pam_orthosis.report.paper.table import Results, rows, tables
from pam_orthosis.report.paper.tracking import Tracking
from pam_orthosis.report.plots import AFTER, BEFORE, ESTIMATE, MEASURED, REFERENCE, Plot, line
from pam_orthosis.report.run_data import thinned

LOOKS = dict(zip(PATTERNS, ((AFTER, "solid"), (BEFORE, "dash")), strict=True))
LAG = "lag of the disturbance / ms"
MOST = 1000  # points of a curve
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
        Part("Fig. 8: observer under a sinusoidal disturbance", plots=_observer(found.observer)),
        Part("What less lag costs", plots=_trade_off(found.trade_off)),
        Part("Fig. 9: tracking and error over the gait", plots=_tracking(found.tracking)),
        *(Part(one.title, (one.words,), listed(one.head, one.rows)) for one in tables(found.as_dict())),
        *(Part(SCHEMES[name], pictures=[Picture(SCHEMES[name], png)]) for name, png in schematic.items()),
    ]
    return Page(
        "paper", "side by side", NEUTRAL, headline, meaning, parts, "the paper's results again"
    ).html()


def _curve(x: Any, y: Any, *look: Any) -> dict[str, Any]:
    return line(*thinned(np.asarray(x), np.asarray(y), MOST), *look)


def _observer(run: ObserverRun) -> list[Plot]:
    s, time = run.signals, run.signals["time"]
    panels = {
        "angle / deg": (time, np.degrees(s["true_angle"]), np.degrees(s["estimate_angle"])),
        "velocity / deg/s": (time, np.degrees(s["true_velocity"]), np.degrees(s["estimate_velocity"])),
        "disturbance / N m": (run.disturbance_time, run.disturbance, s["disturbance"]),
    }
    return [
        Plot(label.split(" / ")[0], f"{label}: true and estimated over time", "time / s", label, [
            _curve(instants, true, "true", REFERENCE, "dash", 2.2),
            _curve(time, estimated, "estimated", ESTIMATE),
        ], (), "fig. 8")
        for label, (instants, true, estimated) in panels.items()
    ]  # fmt: skip


def _trade_off(points: Any) -> list[Plot]:
    return [
        Plot(label.split(" / ")[0], f"{label} over the lag of the disturbance", LAG, label, [
            _pattern([one for one in points if one.damping == damping], kind, name, *LOOKS[damping])
            for damping, name in PATTERNS.items()
        ])
        for kind, label in PANELS.items()
    ]  # fmt: skip


def _pattern(points: list[TradeOff], kind: str, *look: str) -> dict[str, Any]:
    lags, values = [one.lag * 1e3 for one in points], [getattr(one, kind) for one in points]
    return line(lags, values, *look) | {"mode": "lines+markers"}


def _tracking(found: Tracking) -> list[Plot]:
    error = f"error at most {found.largest:.2f} deg"
    alt = f"knee angle over time, reference and measured; {error}"
    return [
        Plot("Knee angle", alt, "time / s", "knee angle / deg", [
            _curve(found.time, found.reference, "reference", REFERENCE, "dash", 2.2),
            _curve(found.time, found.angle, "measured", MEASURED),
        ], (), "fig. 9"),
        Plot("Error: reference less measured", error, "time / s", "error / deg",
             [_curve(found.time, found.error, "error", MEASURED)], (3.0, -3.0), "fig. 9"),
    ]  # fmt: skip
