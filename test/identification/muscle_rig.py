# SPDX-License-Identifier: Apache-2.0
"""An emulated rig that differs from one repeat to the next: hysteresis, creep, zeros of its sensors."""

from functools import cache

import casadi as ca
import numpy as np

from pam_orthosis.identification.damping import slip_element
from pam_orthosis.model.components.muscle import geometric_force
from pam_orthosis.model.parameters import load

LENGTH = 0.3  # m
LEVELS = np.linspace(1.5e5, 6.0e5, 6)  # Pa gauge
NAMES = "t_s,p_Pa_gauge,L_m,F_N,repeat"


@cache
def _law():
    changed = {"muscle.dmsp_20.length": LENGTH, "muscle.dmsp_20.map_length": LENGTH}
    m = load(changed).muscle.dmsp_20
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    return ca.Function("law", [x, p], [geometric_force(x, p, m)])


def static_force(contraction, pressure):
    """Return the force of a DMSP-20-300N, N, by its braid."""
    return np.asarray(_law()(contraction, pressure)).ravel()


def repeat(number, random, samples=60, hysteresis=12.0, creep=0.02, buckling=4.0):
    """Return one repeat, (rows, 5): a sweep to and fro at each level, SI, as in `NAMES`."""
    zero, gain = 3.0 * random.standard_normal(), 1 + 0.003 * random.standard_normal()
    shift, crept, start = 2e-4 * random.standard_normal(), random.random(), 0.0
    rows = []
    for level in random.permutation(LEVELS):
        to_fro = np.concatenate([np.linspace(0, 1, samples), np.linspace(1, 0, samples)])
        x = 0.001 + 0.077 * to_fro
        p = level + 800.0 * random.standard_normal(len(x))
        time = start + 0.1 * np.arange(len(x))
        force = static_force(x, p)
        crept = crept + (random.random() - crept) * 0.5
        slow = creep * crept * np.exp(-np.arange(len(x)) / 60.0)
        taut = (1 - slow) * force - hysteresis / 2 * slip_element(x, 1.5e-3)
        shown = np.where(force > 0, np.maximum(taut, 0.0), buckling * random.random(len(x)))
        shown = gain * shown + zero + random.standard_normal(len(x))
        rows.append(np.column_stack([time, p, LENGTH - x - shift, shown, np.full(len(x), number)]))
        start = time[-1] + 60.0
    return np.vstack(rows)


def write(path, rows, names=NAMES):
    """Write a table."""
    np.savetxt(path, rows, fmt="%.10g", delimiter=",", header=names, comments="")
    return path
