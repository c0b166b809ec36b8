# SPDX-License-Identifier: Apache-2.0
"""What a person brings of the effort that the motion takes, stride by stride, from recorded signals."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.axis import Axis
from pam_orthosis.model.parameters import Parameters

Array = NDArray[np.float64]
PARTS = 4  # of a stride, whose errors are taken for independent: friction changes its sign as often


class Stride(NamedTuple):
    """A stride: when it begins, s, the person's share of the effort, and its standard error."""

    begin: float
    share: float
    error: float


def shares(
    run: Mapping[str, Array], parameters: Parameters, spans: Sequence[tuple[int, int]]
) -> list[Stride]:
    """Return the person's share in each span of samples, from the first to before the last.

    What acts from outside is the observer's disturbance with its sign changed; the effort of the motion, Eq.
    (26), is that of the muscles by the nominal model and what acts from outside together. The share is the
    first one's regression on the second. Friction and errors of the model are in the standard error; what is
    proportional to the effort, such as a wrong mass, is not.

    Args:
        run: signals of `ClosedLoop.run`.
        parameters: the nominal model, whose observer made the estimates.
        spans: of the samples.
    """
    outside = -run["disturbance"]
    needed = _muscle_effort(run, parameters) + outside
    return [_stride(run["time"][first], outside[first:end], needed[first:end]) for first, end in spans]


def _stride(begin: float, outside: Array, needed: Array) -> Stride:
    power = float(needed @ needed)
    share = float(outside @ needed) / power
    rest = outside - share * needed
    return Stride(float(begin), share, float(np.sqrt(rest @ rest / power / PARTS)))


def _muscle_effort(run: Mapping[str, Array], parameters: Parameters) -> Array:
    axis, coordinate = Axis(parameters.nominal()), parameters.declared.coordinate.name
    q, velocity, p = ca.SX.sym("q"), ca.SX.sym("velocity"), ca.SX.sym("p", 2)
    effort = ca.Function("effort", [q, velocity, p], [axis.effort(q, velocity, (p[0], p[1]))])
    pressures = np.vstack([run[f"{name}_pressure"] for name in parameters.declared.names])
    found = effort(run[f"estimate_{coordinate}"][None], run["estimate_velocity"][None], pressures)
    return np.array(found).ravel()
