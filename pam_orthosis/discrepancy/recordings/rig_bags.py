# SPDX-License-Identifier: Apache-2.0
"""Recordings of the test rig, from its bags."""

from pathlib import Path

from pam_orthosis.bag.read import run_record
from pam_orthosis.discrepancy.recordings.data import Recording, from_bag
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.specimens import SPECIMENS
from pam_orthosis.tables import is_table

UNFIT_TESTS = {"decay": "the MAS-40 is unhooked in a free decay"}


def recording(path: Path, system: System, namespace: str = "") -> Recording:
    """Return the recording of a rig bag.

    Raises:
        OrthosisError: as `from_bag`, or a test in which the rig was another one.
    """
    test = run_record(path).get("test")
    if test in UNFIT_TESTS:
        raise OrthosisError(f"{path}: {UNFIT_TESTS[test]}; give bags of other tests")
    return from_bag(path, system, namespace)


def specimen_of(path: Path) -> str | None:
    """Return the investigated muscle of a rig bag; None for a recording of another system."""
    if is_table(path):
        return None
    specimen = run_record(path).get("specimen")
    return specimen if specimen in SPECIMENS else None
