# SPDX-License-Identifier: Apache-2.0
"""The package as a library: `import pam_orthosis as po`. No ROS is needed.

SI units, pressures absolute, error = reference - measured. What a run holds are arrays by the names of the
[topics' signals](topics.md); every object shows itself in a notebook. Unusable input raises
`OrthosisError` with one line that says what to do.
"""

from pam_orthosis.errors import OrthosisError
from pam_orthosis.library.answers import Check, Gap, check, gap
from pam_orthosis.library.muscles import Muscle, identify
from pam_orthosis.library.run import Picture, Run, Runs, example, read
from pam_orthosis.library.simulation import machine, parameters, simulate

__all__ = [
    "Check", "Gap", "Muscle", "OrthosisError", "Picture", "Run", "Runs", "check", "example", "gap",
    "identify", "machine", "parameters", "read", "simulate",
]  # fmt: skip
