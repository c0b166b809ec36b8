# SPDX-License-Identifier: Apache-2.0
"""Parameters that may change while a controller runs: inputs of its functions, not constants in them."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np


def with_symbols(belief, keys: Sequence[str]):
    """Return the belief with a symbol for each key, and the vector of these symbols."""
    symbols = ca.SX.sym("live", len(keys))
    return belief.substituted(dict(zip(keys, ca.vertsplit(symbols), strict=True))), symbols


def values(parameters, keys: Sequence[str]) -> np.ndarray:
    """Return the numbers for the symbols, in the same order."""
    flat = parameters.flat()
    return np.array([flat[key] for key in keys])
