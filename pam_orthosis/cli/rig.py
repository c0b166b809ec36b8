# SPDX-License-Identifier: Apache-2.0
"""Run the identification procedure of the paper's section 2 on the emulated test rig; record bags."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.files import filled, output
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.specimens import SPECIMENS
from pam_orthosis.progress import Progress, shown, silent

if TYPE_CHECKING:
    from pam_orthosis.control.rig_loop import RigSample
    from pam_orthosis.model.rows import Section

IDENTIFICATION = ("force", "volume", "decay")
TESTS = (*IDENTIFICATION, "diagnostic")
EVERY_SAMPLE = ("decay", "diagnostic")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("--muscle", choices=SPECIMENS, default="dmsp_20", help="muscle under test (dmsp_20)")
    parser.add_argument("--out", type=output, metavar="DIR", help="folder of the bags (runs/rig-MUSCLE)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the sensor noise (1)")
    parser.add_argument(
        "--tests", nargs="+", choices=TESTS, default=IDENTIFICATION,
        help="tests to record (those that `identify` needs); diagnostic: for `gap`, at the full rate",
    )  # fmt: skip
    parser.add_argument("--load-cell", type=float, metavar="N", help="accuracy of the load cell, N (50)")


def execute(arguments: argparse.Namespace) -> int:
    """Record one bag a pressure and test."""
    overrides = {"scenario.seed": arguments.seed}
    if arguments.load_cell is not None:
        overrides["plant.rig.load_cell.accuracy"] = arguments.load_cell
    parameters = load(overrides)
    out = arguments.out or Path("runs") / f"rig-{arguments.muscle}"
    with shown("compiling the model") as progress, filled(out) as folder:
        record_tests(parameters, arguments.muscle, arguments.tests, folder, progress)
    print(out)
    return 0


def record_tests(
    parameters: Parameters, specimen: str, tests: Sequence[str], out: Path, progress: Progress = silent
) -> None:
    """Record one bag for each pressure of some of `TESTS` into a folder."""
    levels = [
        (test, number, pressure)
        for test in tests
        for number, pressure in enumerate(_pressures(parameters.rig, specimen, test))
    ]
    for done, (test, number, pressure) in enumerate(levels):
        name = f"{test}-{pressure / 1e5:.1f}bar"
        progress(f"recording {name}", done, len(levels))
        samples = _samples(parameters, specimen, test, pressure, parameters.scenario.seed + number)
        _record(out / name, parameters, specimen, test, samples)


def _record(
    bag: Path, parameters: Parameters, specimen: str, test: str, samples: Iterator[RigSample]
) -> None:
    from pam_orthosis.bag.rig_record import record_rig

    rig = parameters.rig
    every = 1 if test in EVERY_SAMPLE else round(rig.record_period / rig.control_period)
    record_rig(bag, parameters, specimen, test, samples, every)


def _pressures(rig: Section, specimen: str, test: str) -> list[float]:
    from pam_orthosis.control import rig_loop  # casadi takes a second to load

    if test == "decay":
        return list(getattr(rig.decay, specimen).pressures)
    if test == "volume":
        return list(rig.procedure.pressures)
    if test == "diagnostic":
        return list(rig_loop.DIAGNOSTIC_PRESSURES)
    return sorted([*rig.procedure.pressures, *rig.procedure.held_out_pressures])


def _samples(
    parameters: Parameters, specimen: str, test: str, pressure: float, seed: int
) -> Iterator[RigSample]:
    from pam_orthosis.control import rig_loop

    if test == "decay":
        return rig_loop.DecayRig(parameters, specimen, seed).run(pressure)
    if test == "diagnostic":
        rig = rig_loop.Rig(parameters, specimen, seed, rig_loop.DIAGNOSTIC_START)
        levels = [pressure, pressure + rig_loop.DIAGNOSTIC_STEP]
        return rig_loop.diagnostic_procedure(rig, levels, rig_loop.DIAGNOSTIC_PLACES)
    procedure = rig_loop.force_procedure if test == "force" else rig_loop.volume_procedure
    return procedure(rig_loop.Rig(parameters, specimen, seed), pressure)
