# SPDX-License-Identifier: Apache-2.0
"""Figs. 3 and 7: block diagrams of both loops, with the machine's names and the parameters' values."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from pam_orthosis.model.machines import RIG
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.report.run_data import BAR

Point = tuple[float, float]
ARROW = {"arrowstyle": "-|>", "fc": "k", "shrinkA": 0, "shrinkB": 0}


class Block(NamedTuple):
    """A box: its words, a line each, its centre and its size."""

    words: Sequence[str]
    at: Point
    size: Point = (2.3, 1.2)


class Wire(NamedTuple):
    """A line from block to block that ends in an arrow: its corners, and the signal on it at its middle."""

    corners: Sequence[Point]
    signal: str


def knee_control(p: Parameters) -> Figure:
    """Draw fig. 7: observer, backstepping and decoupled pressure control of the machine of the parameters."""
    c, names = p.control, p.declared.names
    blocks = [
        Block(("trajectory", f"$T$ = {p.scenario.cycle_time:g} s"), (1.1, 4.0), (1.8, 1.2)),
        Block(
            ("backstepping position control", "Eqs. (33)-(37)",
             f"$c_1$ = {c.position.c1:g} /s, $c_2$ = {c.position.c2:g} /s",
             f"$p_{{im}}$ = {c.position.mean_pressure / BAR:g} bar"),
            (4.7, 4.0), (3.1, 1.7),
        ),
        Block(
            (f"nonlinear observer of the {p.declared.name}", "Eqs. (29)-(32)",
             f"poles {c.observer.pole:g} /s, damping {c.observer.damping:g}"),
            (8.6, 0.9), (3.4, 1.3),
        ),
        Block(
            ("valves, muscles,", f"{p.declared.name} of Eqs. (24)-(28)",
             f"$d_{{cw}}$ = {p.leg.cogwheel_diameter:g} m", f"supply {p.valve.supply_pressure / BAR:g} bar",
             f"sampled each {1e3 * p.scenario.control_period:g} ms"),
            (15.1, 4.0), (2.7, 3.0),
        ),
    ]  # fmt: skip
    wires = [
        Wire(((2.0, 4.0), (3.15, 4.0)), r"$q_d, \dot q_d, \ddot q_d$"),
        Wire(((15.1, 2.5), (15.1, 0.9), (10.3, 0.9)), f"$q, p_{{{names[0][0]}}}, p_{{{names[1][0]}}}$"),
        Wire(((6.9, 0.9), (4.7, 0.9), (4.7, 3.15)), r"$\hat q, \dot{\hat q}, \hat\tau$"),
    ]
    for name, y, over in zip(names, (5.0, 3.0), (6.3, 1.9), strict=True):
        side, edge = name[0], 0.6 if over > y else -0.6
        blocks += [
            Block((f"{name} pressure", "control, Eq. (6)", f"gain {c.pressure.gain:g} /s"), (8.6, y)),
            Block(("inverse valve model", f"of the {name}", f"{p.valve.dead_band:g} V dead band"), (11.8, y)),
        ]
        wires += [
            Wire(((6.25, y - (y - 4) / 2), (6.8, y - (y - 4) / 2), (6.8, y), (7.45, y)), f"$p_{{{side},d}}$"),
            Wire(((9.75, y), (10.65, y)), rf"$\dot m_{{{side}}}$"),
            Wire(((12.95, y), (13.75, y)), f"$u_{{{side}}}$"),
            Wire(((14.4, 4 + (1.5 if edge > 0 else -1.5)), (14.4, over), (8.6, over), (8.6, y + edge)),
                 f"$p_{{{side}}}$"),
        ]  # fmt: skip
    return _drawn(blocks, wires, (17.0, 7.0))


def rig_control(p: Parameters) -> Figure:
    """Draw fig. 3: exact linearisation of the carriage's position, PI control of the specimen's pressure."""
    rig, (specimen, positioner) = RIG.taken(p).rig, (muscle_name(one.parameters) for one in RIG.actuators)
    blocks = [
        Block(("reference ramp", f"corner {rig.reference.corner:g} /s"), (1.3, 4.0)),
        Block(
            ("stabilising input", "Eq. (12), four poles", f"at -{rig.position.pole:g} /s"), (4.6, 4.0)
        ),
        Block(("exact linearisation", "Eq. (11)"), (7.9, 4.0)),
        Block(("inverse valve model", f"of the {positioner}"), (11.2, 4.0)),
        Block(
            ("test rig", "Eqs. (1)-(8)", f"$m_S$ = {rig.carriage_mass:g} kg",
             f"$X_S$ = {1e3 * rig.position_offset:g} mm", f"supply {rig.supply_pressure / BAR:g} bar",
             f"each {1e3 * rig.control_period:g} ms"),
            (14.9, 3.0), (2.6, 3.9),
        ),
        Block(("observer of the carriage", f"poles about -{rig.position.observer_pole:g} /s"), (7.9, 2.2),
              (3.0, 0.9)),
        Block(("PI pressure control", f"{rig.pressure.gain:g} /s, {rig.pressure.integral:g} /s"), (7.9, 0.6)),
        Block(("inverse valve model", f"of the {specimen}"), (11.2, 0.6)),
    ]  # fmt: skip
    wires = [
        Wire(((2.45, 4.0), (3.45, 4.0)), r"$x_S^d, ...$"),
        Wire(((5.75, 4.0), (6.75, 4.0)), "$v$"),
        Wire(((9.05, 4.0), (10.05, 4.0)), r"$\dot m_{M,r}$"),
        Wire(((12.35, 4.0), (13.6, 4.0)), "$u_r$"),
        Wire(((13.6, 2.2), (9.4, 2.2)), r"$x_S, p_{M,r}, F_{M,d}$"),
        Wire(((6.4, 2.2), (4.6, 2.2), (4.6, 3.4)), r"$\hat x_S, \dot{\hat x}_S, \ddot{\hat x}_S$"),
        Wire(((7.9, 2.65), (7.9, 3.4)), r"$\hat x_S, \dot{\hat x}_S$"),
        Wire(((4.6, 0.6), (6.75, 0.6)), "$p^d_{M,d}$"),
        Wire(((9.05, 0.6), (10.05, 0.6)), r"$\dot m_{M,d}$"),
        Wire(((12.35, 0.6), (14.2, 0.6), (14.2, 1.05)), "$u_d$"),
        Wire(((15.4, 1.05), (15.4, -0.5), (7.9, -0.5), (7.9, 0.0)), "$p_{M,d}$"),
    ]
    return _drawn(blocks, wires, (16.6, 6.0), low=-1.0)


def muscle_name(branch: str) -> str:
    """Return how a muscle is called, by its branch of the parameters."""
    return branch.removeprefix("muscle.").replace("_", "-").upper()


def _drawn(blocks: Iterable[Block], wires: Iterable[Wire], size: Point, low: float = 0.0) -> Figure:
    width, height = size
    figure = Figure(figsize=(0.8 * width, 0.8 * height), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0, width), ylim=(low, low + height), aspect="equal")
    axes.axis("off")
    for block in blocks:
        (x, y), (w, h) = block.at, block.size
        box = FancyBboxPatch((x - w / 2, y - h / 2), w, h, boxstyle="square,pad=0", fc="0.96", ec="k")
        axes.add_patch(box)
        axes.text(x, y, "\n".join(block.words), ha="center", va="center", fontsize=8)
    for wire in wires:
        axes.plot(*zip(*wire.corners[:-1], strict=True), color="k", lw=1)
        axes.annotate("", wire.corners[-1], wire.corners[-2], arrowprops=ARROW)
        _write_signal(axes, wire)
    return figure


def _write_signal(axes: Axes, wire: Wire) -> None:
    """Write a signal above the longest level part of its wire, or beside it if none is level."""
    level = [(a, b) for a, b in pairwise(wire.corners) if a[1] == b[1]]
    (x1, y1), (x2, y2) = max(
        level or [(wire.corners[0], wire.corners[1])], key=lambda part: abs(part[1][0] - part[0][0])
    )
    x, y = (x1 + x2) / 2, (y1 + y2) / 2
    if level:
        axes.text(x, y + 0.06, wire.signal, ha="center", va="bottom", fontsize=9)
    else:
        axes.text(x + 0.1, y, wire.signal, ha="left", va="center", fontsize=9)
