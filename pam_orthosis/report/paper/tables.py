# SPDX-License-Identifier: Apache-2.0
"""Tables beside the one of results, from plain data as `pam-orthosis paper --json` prints it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

Data = Sequence[Mapping[str, Any]]


class Listed(NamedTuple):
    """A table: its title, words below that, its head and its rows."""

    title: str
    words: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


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
