# SPDX-License-Identifier: Apache-2.0
"""What `identify` answers, for programs and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import as_text, write_files
from pam_orthosis.library import checked_arguments as given
from pam_orthosis.library.options import arguments_named, in_python
from pam_orthosis.library.run import Picture
from pam_orthosis.markup import Shown
from pam_orthosis.model.machine import Machine

if TYPE_CHECKING:
    from pam_orthosis.identification.identify import Identified

LISTS = "identify: give a list of bags or tables, such as po.identify(['table.csv'])"
SHORTEST = 1e-3  # m: what is below it is no length of a muscle in m


@dataclass(frozen=True, eq=False, repr=False)
class Muscle(Shown):
    """An identified muscle.

    Attributes:
        found: coefficients of Eq. (14), their intervals, errors, the box in which they hold.
    """

    found: Identified

    def as_dict(self) -> dict[str, Any]:
        """Return all as plain data, SI."""
        return self.found.as_dict()

    @arguments_named()
    def save(self, path: str | Path) -> None:
        """Write the rows for a nominal model, as `identify --out` does.

        Raises:
            OrthosisError: the file exists, or the coefficients are no muscle's.
        """
        from pam_orthosis.identification import rows

        rows.check(self.found)
        text = rows.as_yaml(self.found, "identified by pam_orthosis.identify")
        write_files({given.path(path, "path"): as_text(text)})

    def plot(self) -> Picture:
        """Return measured and calculated force against the contraction."""
        from pam_orthosis.report.identification import force_figure

        return Picture(force_figure(self.found))

    def _shown(self) -> tuple[Sequence[str], list[tuple[str, str, str, str]], str]:
        held = {"fitted": self.found.errors(False), "held out": self.found.errors(True)}
        rows = [
            (name, f"{one['rms']:.2f}", f"{one['max']:.2f}", str(one["samples"]))
            for name, one in held.items()
            if one
        ]
        head = ("data", "RMS error / N", "maximum / N", "samples")
        return head, rows, f"muscle {self.found.data.specimen}, nominal length {self.found.data.length:g} m"


@arguments_named()
def identify(
    data: Sequence[str | Path],
    muscle: str | Path | None = None,
    nominal_length: float | None = None,
    machine: Machine | str | Path | None = None,
    held_out: Sequence[float] | None = None,
    degrees: Sequence[int] = (3, 4),
    damping: float | None = None,
) -> Muscle:
    """Identify a muscle, Eqs. (18)-(23), as the verb `identify` does.

    Args:
        data: rig bags, `.csv` tables, or folders of them.
        muscle: which, if bags and names of files do not say; or a YAML file with its length and diameter.
        nominal_length: of the muscle of a table, m.
        machine: the muscles are those of this machine, or of its YAML file, and its values.
        held_out: absolute pressures, Pa, that judge and are not fitted (`rig.procedure.held_out_pressures`).
        degrees: of the polynomials of Eq. (14).
        damping: N s/m, instead of that of the decays.

    Raises:
        OrthosisError: the data do not determine the parameters, or an argument is unusable.
    """
    from pam_orthosis.identification.asked import bench_and_muscle, held_out_gauge
    from pam_orthosis.identification.data import read_data
    from pam_orthosis.identification.identify import identify as identified

    paths = [given.path(one, "data") for one in given.several(data, LISTS)]
    if not paths:
        raise OrthosisError("identify: there are no data; give one or more in a list")
    named = None if muscle is None else str(given.path(muscle, "muscle"))
    bench, name = bench_and_muscle(named, given.machine(machine))
    length = None if nominal_length is None else given.number(nominal_length, "nominal_length (m)", SHORTEST)
    used = None if damping is None else given.number(damping, "damping")
    polynomials, judging = _degrees(degrees), _pressures(held_out)
    read = read_data(paths, name, length, bench=bench)
    gauge = held_out_gauge(read, judging)
    with naming(paths[0] if len(paths) == 1 else None):
        found = identified(read, gauge, polynomials, used)
    return Muscle(replace(found, remarks=tuple(map(in_python, found.remarks))))


def _pressures(asked: object) -> list[float] | None:
    if asked is None:
        return None
    advice = "held_out: give a list of absolute pressures, Pa"
    return [given.number(one, "held_out (Pa)") for one in given.several(asked, advice)]


def _degrees(asked: object) -> tuple[int, int]:
    from pam_orthosis.identification.asked import HIGHEST, check_degrees

    advice = "degrees: give two whole numbers, such as (3, 4)"
    two = [given.whole(one, "degrees", 0, max(HIGHEST)) for one in given.several(asked, advice)]
    if len(two) != len(HIGHEST):
        raise OrthosisError(advice)
    check_degrees(two)
    return two[0], two[1]
