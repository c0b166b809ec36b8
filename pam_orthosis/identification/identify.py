# SPDX-License-Identifier: Apache-2.0
"""From the data of one muscle to its parameters, and how far they can be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.identification.damping import Damping, check_period, fit_damping
from pam_orthosis.identification.data import Data
from pam_orthosis.identification.directions import (
    Hysteresis,
    between_directions,
    check_direction,
    hysteresis,
)
from pam_orthosis.identification.force import ForceFit, ForceModel, fit_force, leave_one_out, rms_and_max
from pam_orthosis.identification.groups import lengths
from pam_orthosis.identification.kept import not_identified
from pam_orthosis.identification.samples import Samples
from pam_orthosis.identification.trust import (
    astray,
    check_repeats,
    check_size,
    check_slack_pressure,
    check_zero,
    clipped,
    copied,
    levelled_off,
    taut,
)
from pam_orthosis.identification.volume import VolumeFit, fit_volume
from pam_orthosis.progress import Progress, silent

USUAL_MISFIT = 6.0  # N, of a force map, that the gap workflow expects (the prior of its force_map_misfit)
DIRECTIONS = {1.0: "shortening", -1.0: "stretching", 0.0: "rest"}


class Box(NamedTuple):
    """Where the polynomials hold: contraction m, gauge pressure Pa."""

    minimum_contraction: float
    maximum_contraction: float
    minimum_pressure_gauge: float
    maximum_pressure_gauge: float


@dataclass(frozen=True)
class Identified:
    """What identification found.

    Attributes:
        data: what it was found from; `training` and `held_out` are its force samples.
        force: Eq. (14) with D.
        damping, volume: None where the data hold no decay, no cylinder.
        given_damping: D, N s/m, that was to be taken in place of the decays'; None: none was.
        left_out: kind (`level`, `length`, `repeat`) -> value -> error of a fit without it (RMS, max N;
            None: not determined by the others).
        box: recommended box of validity.
        stiff: whether the modelled force falls with the contraction all over the taut box.
        hysteresis: None where the data have one direction, or do not say it.
        between: how far each coefficient, a then b, may be off since both directions differ; no interval of
            repeats holds it. None as the hysteresis.
        remarks: on rows that were left out, and on what is not plausible.
    """

    data: Data
    training: Samples
    held_out: Samples
    force: ForceFit
    damping: Damping | None
    volume: VolumeFit | None
    left_out: dict[str, dict[float, tuple[float, float] | None]]
    box: Box
    stiff: bool
    given_damping: float | None = None
    hysteresis: Hysteresis | None = None
    between: np.ndarray | None = None
    remarks: tuple[str, ...] = ()

    @property
    def not_identified(self) -> str:
        """What was not identified, and what counts then, in words; empty if all was."""
        damping = self.damping is not None or self.given_damping is not None
        return not_identified(self.data, self.volume is not None, damping)

    @property
    def misfit_size(self) -> float:
        """How large the force map's misfit is to be in a machine file: twice the error, of what is usual."""
        rms = (self.errors(held_out=True) or self.errors(held_out=False))["rms"]
        return float(f"{max(2 * rms / USUAL_MISFIT, 0.01):.1g}")

    def errors(self, held_out: bool) -> dict[str, Any]:
        """Return RMS and maximum error, N: overall, by level (bar gauge) and by direction."""
        s = self.held_out if held_out else self.training
        if not len(s):
            return {}
        residual = self.force.model.residual(s)
        by_level = {f"{level / 1e5:.3g}": residual[s.level == level] for level in np.unique(s.level)}
        by_direction = {
            name: residual[s.direction == sign]
            for sign, name in DIRECTIONS.items()
            if (s.direction == sign).any()
        }
        return {
            "samples": len(s),
            **_told(residual),
            "by_pressure_bar_gauge": {name: _told(part) for name, part in by_level.items()},
            "by_direction": {name: _told(part) for name, part in by_direction.items()},
        }

    def as_dict(self) -> dict[str, Any]:
        """Return all as plain data for JSON; SI units."""
        fit, model = self.force, self.force.model
        return {
            "muscle": self.data.specimen,
            "nominal_length": self.data.length,
            "a": model.a.tolist(),
            "b": model.b.tolist(),
            "half_interval_95": fit.half_width.tolist(),
            "half_between_directions": None if self.between is None else self.between.tolist(),
            "damping": _plain(self.damping),
            "damping_used": model.damping,
            "volume": _plain(self.volume),
            "not_identified": self.not_identified or None,
            "rank": fit.rank,
            "condition_scaled": fit.condition,
            "condition_unscaled": fit.condition_raw,
            "effective_samples": fit.effective,
            "training": self.errors(held_out=False),
            "held_out": self.errors(held_out=True),
            "intervals_by": {"kind": fit.clustered, "number": fit.clusters} if fit.clustered else None,
            "hysteresis": self.hysteresis._asdict() if self.hysteresis else None,
            "remarks": list(self.remarks),
            "left_out": {
                kind: {f"{at:g}": e and {"rms": e[0], "max": e[1]} for at, e in errors.items()}
                for kind, errors in self.left_out.items()
            },
            "box": self.box._asdict(),
            "force_falls_with_contraction": self.stiff,
        }


def identify(
    data: Data,
    held_out: Sequence[float] = (),
    degrees: tuple[int, int] = (3, 4),
    damping: float | None = None,
    progress: Progress = silent,
) -> Identified:
    """Identify a muscle.

    Args:
        held_out: gauge pressures, Pa, of runs that judge and do not enter the fit.
        degrees: of area function and counterforce, Eq. (14).
        damping: D, N s/m, in place of the decays'; None: theirs, zero if there are none.

    Raises:
        OrthosisError: the data do not determine the parameters, or all of them are held out.
    """
    progress("fitting the damping")
    decay = fit_damping(data.decays) if data.decays else None
    d = damping if damping is not None else (decay.value if decay else 0.0)
    samples, remarks = usable(data, d, degrees)
    judged = np.zeros(len(samples), dtype=bool)
    for level in held_out:
        judged |= _at_level(samples, level)
    training = samples.where(~judged)
    if not len(training):
        raise OrthosisError("all data are held out: nothing is left to fit")
    progress("fitting the force")
    force = fit_force(training, d, degrees)
    _check_periods(data, training, force.model)
    friction = hysteresis(force.model, training)
    remarks += _cautions(data, training, force.model, friction)
    left_out = {
        kind: leave_one_out(training, group, lambda s: fit_force(s, d, degrees), progress)
        for kind, group in _groups(data, training).items()
    }
    box = _box(training)
    progress("fitting the volume")
    degree = len(data.parameters.at(f"muscle.{data.specimen}.volume.v")) - 1
    with naming(data.volume_source):
        volume = fit_volume(data.volumes, degree) if data.volumes else None
    return Identified(
        data, training, samples.where(judged), force, decay,
        volume, left_out, box, _stiff(force, box), damping, friction,
        between_directions(force.model, training), tuple(remarks),
    )  # fmt: skip


def _check_periods(data: Data, s: Samples, model: ForceModel) -> None:
    """Compare the periods of decays with the fitted muscle's stiffness; OrthosisError if one is far off."""
    step = np.ptp(s.contraction) / 200
    for one in data.decays:
        gauge = np.full(len(s), one.pressure.mean())
        falls = model.towing(s.contraction, gauge) - model.towing(s.contraction + step, gauge)
        if (falls > 0).any():
            with naming(one.source):
                check_period(one, falls[falls > 0] / step)


def _cautions(data: Data, training: Samples, model: ForceModel, friction: Hysteresis | None) -> list[str]:
    """Return what is not plausible in the samples and in what was fitted to them, in words."""
    geometry = data.parameters.at(f"muscle.{data.specimen}.geometry")
    angle = geometry.fibre_angle + geometry.fibre_angle_correction
    found = (
        check_slack_pressure(model, training, data.length),
        check_size(model, training, data.length, geometry.diameter, angle),
        astray(model, training),
        check_direction(model, training, friction),
        check_repeats(training, data.length) if data.static else "",
    )
    return [f"caution: {one}" for one in found if one]


def usable(data: Data, damping: float, degrees: tuple[int, int]) -> tuple[Samples, list[str]]:
    """Return the samples that Eq. (14) holds for, and what was left out, in words."""
    s, remarks = data.samples, [*data.assumed]
    copies = copied(s)
    if copies.any():
        remarks.append(
            f"{copies.sum()} of {len(s)} rows left out: they repeat an earlier one in every column"
        )
        s = s.where(~copies)
    end = clipped(s, data.length)
    if end.any():
        remarks.append(
            f"{end.sum()} rows left out: they hold exactly {s.force.max():g} N, the largest one, in different"
            " states; the load cell or its amplifier ends there"
        )
        s = s.where(~end)
    if s.force.max(initial=0.0) <= 0:
        low, high = data.samples.force.min(), data.samples.force.max()
        raise OrthosisError(f"forces from {low:g} to {high:g} N: a pull is positive, and not always the same")
    end = levelled_off(s, data.length, damping, degrees)
    if end.any():
        remarks.append(
            f"{end.sum()} rows left out: all hold about {np.median(s.force[end]):.1f} N, the largest one, in"
            " different states where the rest says more; the load cell or its amplifier ends there"
        )
        s = s.where(~end)
    if data.static and not data.marked:
        kept, zero = taut(s, damping, degrees)
        if not kept.all():
            loose = s.force[~kept]
            remarks.append(
                f"{len(loose)} of {len(s)} rows left out: the muscle hangs slack, is buckled or all but"
                f" force-free (it shows {loose.min():.1f} to {loose.max():.1f} N); a column slack decides"
                " instead"
            )
            off = check_zero(loose, zero, float(s.force.max()))
            remarks += [f"caution: {off}"] if off else []
            s = s.where(kept)
    return s, remarks


def _groups(data: Data, s: Samples) -> dict[str, np.ndarray]:
    """Return what is left out as a whole, to see how the rest predicts it: kind -> group of each row."""
    groups = {"level": s.level, "length": lengths(s.contraction, data.length)} if data.static else {}
    return groups | {"repeat": s.repeat} if np.ptp(s.repeat) else groups


def check_levels(data: Data, pressures: Sequence[float], ambient: float) -> None:
    """Refuse, by OrthosisError, absolute pressures, Pa, at which there are no data."""
    most_told = 12  # pressures of the data
    for pressure in pressures:
        if not _at_level(data.samples, pressure - ambient).any():
            levels = np.unique(data.samples.level)[:most_told]
            there = ", ".join(f"{(level + ambient) / 1e5:.4g}" for level in levels)
            raise OrthosisError(f"no data at {pressure / 1e5:g} bar absolute to hold out; there are: {there}")


def _at_level(s: Samples, level: float) -> np.ndarray:
    level_tolerance = 2.0e3  # Pa between a pressure that is asked for and the one of a run
    return np.abs(s.level - level) < level_tolerance


def _box(s: Samples) -> Box:
    """Return the measured range: beyond its ends a polynomial of this degree is a guess.

    Only towards low pressure the force may be continued, being linear in the pressure, Eq. (14).
    """
    low, high = float(s.contraction.min()), float(s.contraction.max())
    zero = 1.0e-3  # m: data from here on reach the nominal length
    return Box(0.0 if low < zero else low, high, 0.0, float(s.level.max()))


def _stiff(fit: ForceFit, box: Box) -> bool:
    x = np.linspace(box.minimum_contraction, box.maximum_contraction, 200)
    for pressure in np.linspace(box.minimum_pressure_gauge, box.maximum_pressure_gauge, 15)[1:]:
        force = fit.model.towing(x, pressure)
        if (np.diff(force)[force[1:] > 0] > 0).any():
            return False
    return True


def _told(residual: np.ndarray) -> dict[str, float]:
    rms, largest = rms_and_max(residual)
    return {"rms": rms, "max": largest, "mean": float(residual.mean())}


def _plain(result: object) -> dict[str, Any] | None:
    if result is None:
        return None
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(result).items()}
