# SPDX-License-Identifier: Apache-2.0
"""The paper's figures that show no run, by the names of their files: figs. 1 to 3, 6 and 7."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import Any

from pam_orthosis.model.parameters import load
from pam_orthosis.report.paper import blocks, drawings

DPI = 110
SCHEMES = {
    "device": "Fig. 1: the device, both legs half a cycle apart",
    "rig": "Fig. 2: test rig",
    "rig_control": "Fig. 3: control of the test rig",
    "mechanics": "Fig. 6: bodies and angles of the mechanical model",
    "knee_control": "Fig. 7: observer-based control of the knee",
}
PERSON = {"leg.person.present": True}  # fig. 6 shows the person's bodies too


def schemes(overrides: Mapping[str, Any] | None = None) -> dict[str, bytes]:
    """Return each figure as PNG, drawn from the declared machines with some parameters changed."""
    given = overrides or {}
    p = load(given)
    figures = {
        "device": drawings.device(given),
        "rig": drawings.rig(p),
        "rig_control": blocks.rig_control(p),
        "mechanics": drawings.mechanics(load({**PERSON, **given})),
        "knee_control": blocks.knee_control(p),
    }
    return {name: _png(figure) for name, figure in figures.items()}


def _png(figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, dpi=DPI, format="png")
    return stream.getvalue()
