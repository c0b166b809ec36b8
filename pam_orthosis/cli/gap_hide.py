# SPDX-License-Identifier: Apache-2.0
"""Record a blind test case of the gap workflow: bags of a machine with hidden effects, and the answer."""

import argparse
from importlib.util import find_spec
from pathlib import Path

from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import filled, output, refuse_used
from pam_orthosis.progress import Progress, shown

CLASSES, SIZES = ("clean", "realistic"), ("small", "medium", "large")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        "--machine", type=Path, metavar="NAME|FILE", help="ankle, shoe, or the YAML file of a machine of two"
        " actuators (the knee)",
    )  # fmt: skip
    parser.add_argument(
        "--class", dest="class_", choices=CLASSES, default="clean", help="clean: only effect and tolerances"
        " differ; realistic: force map, valve curve and volume are off in shape too (clean)",
    )  # fmt: skip
    parser.add_argument("--size", choices=SIZES, default="medium", help="size of the effects (medium)")
    parser.add_argument(
        "--effect", action="append", metavar="NAME", help="effect to hide, `random` or `none`; repeatable"
        " (random)",
    )  # fmt: skip
    parser.add_argument("--outside", action="store_true", help="hide effects that are not in the catalogue")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of everything that is drawn (1)"
    )
    parser.add_argument("--out", type=output, required=True, metavar="DIR", help="new folder of the case")


def execute(arguments: argparse.Namespace) -> int:
    """Record and write the case; print where it is; return 0."""
    if find_spec("numba") is None:
        raise OrthosisError("numba is not installed, which simulates the hidden plant: pip install numba")
    refuse_used(arguments.out)
    if arguments.seed < 0:
        raise OrthosisError("--seed: give a whole number from 0 on")
    effects = _effects(arguments.effect or ["random"])
    with shown("loading the simulation") as progress:
        training, held_out, truth = _recorded(arguments, effects, progress)
    print("training: ", *(arguments.out / one.name for one in training))
    print("held out: ", *(arguments.out / one.name for one in held_out))
    print("answer:   ", arguments.out / truth)
    return 0


def _recorded(
    arguments: argparse.Namespace, effects: int | list[str], progress: Progress
) -> tuple[list[Path], list[Path], Path]:
    """Record the case; return its bags and the file of its answer, below its folder."""
    from pam_orthosis.model.machines import machine_named
    from pam_orthosis.testing.case import make_case, nominal
    from pam_orthosis.testing.write import write_case

    parameters = nominal(machine_named(arguments.machine) if arguments.machine else None)
    case = make_case(
        arguments.seed,
        arguments.class_,
        arguments.size,
        effects,
        arguments.outside,
        progress=progress,
        parameters=parameters,
    )
    progress("writing the bags")
    with filled(arguments.out) as folder:
        training, held_out, truth = write_case(case, folder)
        return training, held_out, truth.relative_to(folder)


def _effects(names: list[str]) -> int | list[str]:
    """Return the number of effects to draw, or their names."""
    if names == ["none"]:
        return 0
    if "none" in names or 0 < names.count("random") < len(names):
        raise OrthosisError("--effect: give names, or `random` once or more, or `none` alone")
    if names[0] == "random":
        return len(names)
    if twice := [name for name in names if names.count(name) > 1]:
        raise OrthosisError(f"--effect {twice[0]} is given twice; give it once")
    return names
