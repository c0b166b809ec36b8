# SPDX-License-Identifier: Apache-2.0
"""What all actuators have in common: a force and a volume that contraction and pressure decide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import casadi as ca

from pam_orthosis.model.signals import Expression

Law: TypeAlias = Callable[[Expression, Expression], Expression]  # (contraction m, gauge pressure Pa) -> value


@dataclass(frozen=True)
class Actuator:
    """A chamber that does work.

    Attributes:
        force: static force, N; volume: of the chamber, m^3.
        damping: N s/m.
        length: nominal, m, to which relative contractions refer.
        pulls_only: it hangs slack where the static force is negative.
        onset: static force, N, up to which the damping of such an actuator grows to its size; 0: it is there
            at once, and the force leaps where the actuator becomes slack.
        affine: contraction -> area m^2 and counterforce N of a force that is area * gauge - counterforce;
            None: the pressure enters otherwise.
        outside: (contraction, gauge pressure) -> 1 where the laws are not identified, else 0.
    """

    force: Law
    volume: Law
    damping: Expression
    length: Expression
    pulls_only: bool = True
    onset: float = 0.0
    affine: Callable[[Expression], tuple[Expression, Expression]] | None = None
    outside: Law = lambda _contraction, _gauge: 0

    def tension(self, elastic: Expression, rate: Expression) -> Expression:
        """Return the force of Eq. (13), N; a slack muscle (no elastic force) pulls nothing."""
        if not self.pulls_only:
            return elastic - self.damping * rate
        grown = ca.fmin(ca.fmax(elastic / self.onset, 0), 1) if self.onset else 1.0
        return taut(elastic, rate, grown * self.damping)

    def times(self, count: int) -> Actuator:
        """Return so many of these side by side, fed by one valve."""
        if count == 1:
            return self
        volume = self.volume
        many = replace(self, volume=lambda dl, p: count * volume(dl, p), damping=count * self.damping)
        return many.scaled(count)

    def scaled(self, factor: Expression) -> Actuator:
        """Return an actuator whose static force is larger by a factor."""
        affine = self.affine
        return replace(
            self,
            force=lambda dl, p: factor * self.force(dl, p),
            affine=affine and (lambda dl: tuple(factor * part for part in affine(dl))),
        )


def taut(elastic: Expression, rate: Expression, damping: Expression) -> Expression:
    """Return what an elastic force less the damping of Eq. (13) leaves, N, at least zero."""
    return ca.if_else(elastic > 0, ca.fmax(elastic - damping * rate, 0), 0)


def volume_terms(law: Law, contraction: Expression, gauge: Expression) -> list[Expression]:
    """Return V, dV/dp and dV/d(dL) of a volume law, for Eq. (6)."""
    dl, p = ca.SX.sym("dl"), ca.SX.sym("p")
    volume = law(dl, p)
    terms = [volume, ca.gradient(volume, p), ca.gradient(volume, dl)]
    return list(ca.substitute(terms, [dl, p], [ca.SX(contraction), ca.SX(gauge)]))
