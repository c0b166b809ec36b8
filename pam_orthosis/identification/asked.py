# SPDX-License-Identifier: Apache-2.0
"""What is asked of an identification beside its data: verb and library read it here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.identification.data import Bench, Data, bench_of
from pam_orthosis.identification.identify import check_levels
from pam_orthosis.identification.own import SECTION, own_bench
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import machine_named

HIGHEST = 3, 4  # degrees of Eq. (14)


def check_degrees(degrees: Sequence[int]) -> None:
    """Refuse, by OrthosisError, degrees of polynomials that Eq. (14) does not have."""
    if min(degrees) < 0 or degrees[0] > HIGHEST[0] or degrees[1] > HIGHEST[1]:
        raise OrthosisError("--degrees: Eq. (14) has at most degrees 3 and 4")


def bench_and_muscle(muscle: str | None, machine: Path | Machine | None) -> tuple[Bench, str | None]:
    """Return where it was measured, and the name of the muscle, if given.

    `muscle`: its name, or the file of one that is none of `config/`. `machine`: or its file.

    Raises:
        OrthosisError: a file is unusable, both say what the muscle is, or the machine has none.
    """
    if not muscle or Path(muscle).suffix not in (".yaml", ".yml"):
        with naming(machine if isinstance(machine, Path) else None):
            return bench_of(machine_named(machine) if isinstance(machine, Path) else machine), muscle
    if machine:
        raise OrthosisError("--machine and --muscle FILE each say what the muscle is: give one")
    return own_bench(Path(muscle)), SECTION


def held_out_gauge(data: Data, asked: Sequence[float] | None) -> list[float]:
    """Return gauge pressures, Pa, of absolute ones that are asked for, or else of `rig.procedure`.

    Raises:
        OrthosisError: there are no data at one that is asked for.
    """
    ambient = data.parameters.valve.ambient_pressure
    if asked is not None:
        check_levels(data, asked, ambient)
    absolute = data.parameters.rig.procedure.held_out_pressures if asked is None else asked
    return [pressure - ambient for pressure in absolute]
