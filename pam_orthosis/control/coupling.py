# SPDX-License-Identifier: Apache-2.0
"""What a coupled joint's motion asks of this one, by the nominal model along both references.

The cascade's own model is that of a joint alone. The difference of both models' efforts, Eq. (26), is a known
input of observer and law, in no loop of its own; what motions and references differ by is a disturbance.
"""

import casadi as ca

from pam_orthosis.control.reference import Reference
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters

MOTION = 3  # numbers of a motion


def coupling_effort(nominal: Parameters) -> ca.Function:
    """Return (own motion, motion of the coupled joint (3,), live values) -> effort, N m, see above."""
    machine = nominal.declared
    given, live = nominal.symbolic(machine.live)
    own, other = ca.SX.sym("own", MOTION), ca.SX.sym("other", MOTION)
    models = machine.beside(given, other), machine.mechanism(given)
    together, alone = (
        terms.inertia * own[2] + terms.coriolis + terms.gravity
        for terms in (model.terms(own[0], own[1]) for model in models)
    )
    return ca.Function("coupling_effort", [own, other, live], [together - alone])


class Coupling:
    """The effort that the coupling asks of a joint; zero for a machine that is coupled to nothing."""

    def __init__(self, nominal: Parameters):
        self._live = nominal.declared.live
        self._effort = compiled(coupling_effort(nominal)) if nominal.declared.coupled else None
        self.retune(nominal)

    def retune(self, parameters: Parameters) -> None:
        """Take the values of the machine's live keys."""
        self._values = [parameters.at(key) for key in self._live]

    def effort(self, reference: Reference, ahead: float = 0.0) -> float:
        """Return it at a reference, N m; the coupled joint's motion goes on for so long, s, as it is."""
        if self._effort is None or reference.beside is None:
            return 0.0
        q, v, a = reference.beside
        beside = q + ahead * (v + ahead * a / 2), v + ahead * a, a
        return float(self._effort([*reference[:2], reference.acceleration], beside, self._values)[0][0])
