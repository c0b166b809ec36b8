# SPDX-License-Identifier: Apache-2.0
"""Write a blind case: bags for the workflow, the answer apart from them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.files import write_text
from pam_orthosis.testing.case import Case, Recording

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine

_KINDS = ("pressure", "pressure_reference", "mass_flow", "voltage")


def write_case(case: Case, folder: Path) -> tuple[list[Path], list[Path], Path]:
    """Write `training_NAME` and `held_out_NAME` bags below `folder`, and `sealed/truth.json`.

    The bags hold the nominal model only. Returns the training bags, the held-out bags and the answer's file.

    Raises:
        OrthosisError: the folder holds a case or cannot be written.
    """
    training = [_write(folder / f"training_{n}", r, case) for n, r in case.training.items()]
    held_out = [_write(folder / f"held_out_{n}", r, case) for n, r in case.held_out.items()]
    truth = folder / "sealed" / "truth.json"
    write_text(truth, json.dumps(case.answer, indent=2) + "\n")
    return training, held_out, truth


def _write(folder: Path, recording: Recording, case: Case) -> Path:
    signals = {name: recording[name] for name in _written(case.parameters.declared)}
    stamps = np.round(recording["time"] * 1e9).astype(np.int64)
    write_arrays(folder, stamps, signals, run_metadata(case.parameters.nominal(), "blind"))
    return folder


def _written(machine: Machine) -> tuple[str, ...]:
    """Return the signals that a bag of a case holds."""
    q = machine.coordinate.name
    motion = (q, f"reference_{q}", "reference_velocity", "reference_acceleration")
    return (*motion, *(f"{name}_{kind}" for kind in _KINDS for name in machine.names))
