# SPDX-License-Identifier: Apache-2.0
"""The gap engine for systems of one's own: a motor on a rail, a tank, a joint that is not this package's.

Write the nominal model as a `Model`: what is measured, what drives it, its equations, its parameters with
their tolerances, and the effects that may be missing. Then

    outcome = find_gap(model.system(), training, held_out)
    print(describe(outcome))

with recordings from `from_arrays`, `from_csv` or `from_bag`. `pam-orthosis gap --system FILE.py` does the
same with a file that defines `system()`, a function that returns `Model(...).system()`.

A `System` can also be written by hand, from expressions that one has already: `Assembled` says what the
engine takes, `check_system` whether all fits together. Values are in SI units, times in s; symbols are SX of
CasADi.
"""

from pam_orthosis.discrepancy.answer.contract import as_dict
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.answer.verdict import describe
from pam_orthosis.discrepancy.recordings.data import Recording, from_arrays, from_bag, from_csv
from pam_orthosis.discrepancy.systems.builder import Input, Model, Parameter
from pam_orthosis.discrepancy.systems.changes import Curve
from pam_orthosis.discrepancy.systems.soundness import check_system
from pam_orthosis.discrepancy.systems.system import Assembled, Calibration, Channel, Equation, Source, System
from pam_orthosis.discrepancy.systems.user_file import load_system
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

__all__ = [
    "Assembled", "Calibration", "Channel", "Contribution", "Curve", "Effect", "Equation", "Input", "Model",
    "OrthosisError", "Outcome", "Parameter", "Quantity", "Recording", "Source", "System", "as_dict",
    "check_system", "describe", "find_gap", "from_arrays", "from_bag", "from_csv", "load_system",
]  # fmt: skip
