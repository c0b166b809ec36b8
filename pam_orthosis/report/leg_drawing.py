# SPDX-License-Identifier: Apache-2.0
"""The leg in the orthosis, drawn from the model's own kinematics."""

from __future__ import annotations

import casadi as ca
import numpy as np

from pam_orthosis.model import leg as leg_model


def joint_positions(angles: np.ndarray, leg) -> np.ndarray:
    """Return hip, knee and ankle (x, z), m, for knee angles (n,), rad: shape (n, 3, 2)."""
    q = ca.SX.sym("q")
    bodies = leg_model.bodies(q, leg)
    joints = ca.Function("joints", [q], [bodies[1].position, bodies[3].position])
    return np.array([
        [[0.0, 0.0], *(point.full()[:, 0] for point in joints(angle))] for angle in angles
    ])  # fmt: skip


def draw_walk(axes, angles: np.ndarray, leg, colours) -> None:
    """Draw the leg at several knee angles, one colour each, with the bearing and the hip."""
    positions = joint_positions(angles, leg)
    axes.axhline(leg.bearing_height, color="0.8", linewidth=4, zorder=0)
    for points, colour in zip(positions, colours, strict=True):
        axes.plot(*points.T, "-o", color=colour, linewidth=2.5, markersize=5)
        axes.plot(*points[2], "s", color=colour, markersize=8)
    axes.plot(0, 0, "ko", markersize=10)
    below = leg.bearing_height - 0.045
    axes.text(0, -0.045, "hip", ha="center")
    axes.text(positions[:, 2, 0].max(), below, "ankle on its bearing", ha="right")
    axes.text(positions[:, 1, 0].mean(), positions[:, 1, 1].max() + 0.015, "knee", ha="center")
    axes.set_ylim(min(-0.06, below - 0.015), max(0.06, positions[:, 1, 1].max() + 0.05))
    axes.set_aspect("equal")
    axes.set_xlabel("x / m")
    axes.set_ylabel("z / m")
