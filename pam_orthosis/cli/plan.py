# SPDX-License-Identifier: Apache-2.0
"""Plan a cycle within the reach of actuators, valves and supply, by the nominal model.

Where the wanted motion needs more than they can give, the nearest motion that they can make is planned,
with both actuators filled ahead of need. `run --model FILE` lets the machine follow it; errors still count
from the wanted motion.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pam_orthosis.cli.parameters import DEFAULT, add_parameter_arguments, chosen
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import as_text, instead_of_out, output, refuse_existing, write_files
from pam_orthosis.planning import RESERVE
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine
    from pam_orthosis.planning.plan import Plan
    from pam_orthosis.planning.recorded import Recorded

BAR = 1.0e5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    add_parameter_arguments(parser, "motion and person (person; of another machine default)", None)
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="nominal model (by `gap`, `improve` or `identify`)"
    )
    parser.add_argument(
        "--reserve",
        type=float,
        default=RESERVE / BAR,
        metavar="BAR",
        help=f"pressure kept back for the feedback ({RESERVE / BAR:g})",
    )
    parser.add_argument(
        "--after",
        type=Path,
        metavar="BAG",
        help="recorded run of this scenario with this model: its disturbance torque becomes part of the plan,"
        " and where the machine fell short of the last plan more is asked for",
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="of the leg in that bag")
    parser.add_argument("--out", type=output, required=True, metavar="FILE", help="new model with the plan")
    parser.add_argument("--page", type=output, metavar="FILE", help="write a page with curves")


def execute(arguments: argparse.Namespace) -> int:
    """Plan; return 0 if there is a motion that the actuators can make."""
    refuse_existing([arguments.out])
    if arguments.page:
        with instead_of_out("--page"):
            refuse_existing([arguments.page])
    if not 0 <= arguments.reserve <= 1:
        raise OrthosisError(f"--reserve {arguments.reserve:g}: give 0 to 1 bar")
    with shown("compiling the model") as progress:
        machine, plan, after = _planned(arguments, progress)
    summary = _summary(machine, plan, after)
    if arguments.page:
        from pam_orthosis.report.pages import plan as pages

        write_files({arguments.page: as_text(pages.page(machine, plan, summary))})
    print(summary)
    return 0


def _planned(arguments: argparse.Namespace, progress: Progress) -> tuple[Machine, Plan, Recorded | None]:
    """Plan and write it; return the plan and the recorded run that it was made after, if there is one."""
    from pam_orthosis.discrepancy.answer import patch
    from pam_orthosis.planning.plan import make_plan
    from pam_orthosis.planning.recorded import recorded_in

    scenario = arguments.scenario or (DEFAULT if arguments.machine else "person")
    parameters = chosen(arguments, scenario=scenario)
    machine = parameters.declared
    known = patch.read(arguments.model, machine) if arguments.model else {}
    with naming(arguments.model):
        parameters = parameters.changed(patch.nominal_of(known, arguments.model))
    after = recorded_in(arguments.after, parameters, arguments.namespace) if arguments.after else None
    plan = make_plan(parameters, arguments.reserve * BAR, progress, after)
    parameters.changed(plan.overrides)  # the rules of the configuration hold for it, or it is not written
    patch.write(arguments.out, known | plan.overrides)
    return machine, plan, after


def _summary(machine: Machine, plan: Plan, recorded: Recorded | None) -> str:
    import numpy as np

    from pam_orthosis.bag.tracking import rms

    cycle, lines, shown = plan.cycle, [], machine.coordinate.shown
    if recorded:
        missing = recorded.missing(np.arange(len(plan.wanted)) / len(plan.wanted))
        effort = machine.coordinate
        lines.append(
            f"unexplained {effort.effort:8s} {missing.min():.2f} .. {missing.max():.2f} {effort.effort_unit}"
        )
    change = np.abs(cycle.position - plan.wanted)
    usual = f"{rms(change) * machine.coordinate.shown_factor:.2f}"
    lines.append(f"planned motion       within {shown(change.max())} of the wanted one (RMS {usual})")
    if plan.early:
        lines.append(
            f"at the start         within {shown(plan.early.largest)}: what creeps has not settled there"
        )
    if recorded and recorded.planned:
        more = shown(np.abs(plan.asked - cycle.position).max())
        lines.append(
            f"more is asked for    up to {more}: what the {machine.name} fell short of the last plan"
        )
    for name, pressure in zip(machine.names, cycle.pressures, strict=True):
        lines.append(f"{name:8s} pressure    {pressure.min() / BAR:.2f} .. {pressure.max() / BAR:.2f} bar")
    mean = cycle.mean_pressure / BAR
    lines.append(f"mean pressure        {mean.min():.2f} .. {mean.max():.2f} bar")
    return "\n".join(lines)
