# SPDX-License-Identifier: Apache-2.0
"""Plan a gait within the reach of muscles, valves and supply, by the nominal model.

Where the wanted motion needs more than they can give, the nearest motion that they can make is planned,
with both muscles filled ahead of need. `run --model FILE` lets the knee follow it; errors still count
from the wanted motion.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.files import output, refuse_existing
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.planning import RESERVE
from pam_orthosis.progress import Progress, shown

BAR = 1.0e5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("--scenario", default="person", metavar="NAME", help="motion and person (person)")
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="nominal model (by `gap`, `improve` or `identify`)"
    )
    parser.add_argument(
        "--param", action="append", default=[], metavar="KEY=VALUE", help="set a parameter (repeatable)"
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
        " and where the knee fell short of the last plan more is asked for",
    )
    parser.add_argument("--namespace", default="", metavar="NS", help="of the leg in that bag")
    parser.add_argument("--out", type=output, required=True, metavar="FILE", help="new model with the plan")


def execute(arguments: argparse.Namespace) -> int:
    """Plan; return 0 if there is a motion that the muscles can make."""
    refuse_existing([arguments.out])
    if not 0 <= arguments.reserve <= 1:
        raise OrthosisError(f"--reserve {arguments.reserve:g}: give 0 to 1 bar")
    with shown("compiling the model") as progress:
        plan, after = _planned(arguments, progress)
    print(_told(plan, after))
    return 0


def _planned(arguments: argparse.Namespace, progress: Progress):
    """Plan and write it; return the plan and the recorded run that it was made after, if there is one."""
    from pam_orthosis.cli.run import assignments
    from pam_orthosis.discrepancy import patch
    from pam_orthosis.planning.plan import make_plan
    from pam_orthosis.planning.recorded import recorded_in

    known = patch.read_belief(arguments.model) if arguments.model else {}
    parameters = load(scenario_overrides(arguments.scenario) | assignments(arguments.param))
    with naming(arguments.model):
        parameters = parameters.changed(known)
    after = recorded_in(arguments.after, parameters, arguments.namespace) if arguments.after else None
    plan = make_plan(parameters, arguments.reserve * BAR, progress, after)
    parameters.changed(plan.overrides)  # the rules of the configuration hold for it, or it is not written
    patch.write(arguments.out, known | plan.overrides)
    return plan, after


def _told(plan, recorded) -> str:
    import numpy as np

    cycle, lines = plan.cycle, []
    if recorded:
        torque = recorded.missing(np.arange(len(plan.wanted)) / len(plan.wanted))
        lines.append(f"unexplained torque   {torque.min():.2f} .. {torque.max():.2f} N m")
    change = np.degrees(np.abs(cycle.angle - plan.wanted))
    lines.append(
        f"planned motion       within {change.max():.2f} deg of the wanted one (RMS {_rms(change):.2f})"
    )
    if plan.early:
        change = np.degrees(plan.early.largest)
        lines.append(f"at the start         within {change:.2f} deg: what creeps has not settled there")
    if recorded and recorded.planned:
        more = np.degrees(np.abs(plan.asked - cycle.angle).max())
        lines.append(f"more is asked for    up to {more:.2f} deg: what the knee fell short of the last plan")
    for name, pressure in (("extensor", cycle.extensor_pressure), ("flexor", cycle.flexor_pressure)):
        lines.append(f"{name:8s} pressure    {pressure.min() / BAR:.2f} .. {pressure.max() / BAR:.2f} bar")
    mean = (cycle.extensor_pressure + cycle.flexor_pressure) / (2 * BAR)
    lines.append(f"mean pressure        {mean.min():.2f} .. {mean.max():.2f} bar")
    return "\n".join(lines)


def _rms(values) -> float:
    return float((values**2).mean() ** 0.5)
