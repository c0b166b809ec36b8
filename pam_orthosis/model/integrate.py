# SPDX-License-Identifier: Apache-2.0
"""Fixed-step integration of CasADi right-hand sides."""

from collections.abc import Callable

import casadi as ca

from pam_orthosis.model.signals import Expression


def runge_kutta_4(rates: Callable[[Expression], Expression], x: Expression, step: Expression) -> Expression:
    """Return the state after one classical Runge-Kutta step; `rates` maps a state to its rates."""
    k1 = rates(x)
    k2 = rates(x + step / 2 * k1)
    k3 = rates(x + step / 2 * k2)
    k4 = rates(x + step * k3)
    return x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def steps_map(name: str, right_hand_side: ca.Function, steps: int) -> ca.Function:
    """Return (x, inputs of one step after the other, lengths of the steps) -> x after Runge-Kutta steps."""
    x, u = (ca.SX.sym(name, right_hand_side.size1_in(i)) for i, name in enumerate("xu"))
    step = ca.SX.sym("step")
    after = runge_kutta_4(lambda state: right_hand_side(state, u)[0], x, step)
    folded = ca.Function(f"{name}_step", [x, u, step], [after]).fold(steps)
    start, inputs, lengths = (
        ca.MX.sym("x", x.shape[0]),
        ca.MX.sym("u", u.shape[0] * steps),
        ca.MX.sym("h", steps),
    )
    after = folded(start, ca.reshape(inputs, u.shape[0], steps), lengths.T)
    return ca.Function(name, [start, inputs, lengths], [after])
