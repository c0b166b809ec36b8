# SPDX-License-Identifier: Apache-2.0
"""Start the node graph in lockstep, record an MCAP bag and judge it."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.cli.check import add_verdict_arguments, bound_of, show
from pam_orthosis.cli.parameters import (
    DEFAULT,
    add_model_argument,
    add_parameter_arguments,
    assignments,
    check_controllable,
    chosen,
    with_model,
)
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.files import Used, claimed, output
from pam_orthosis.model.parameters import Parameters, scenario_names
from pam_orthosis.progress import Progress, shown

if TYPE_CHECKING:
    from pam_orthosis.nodes import launch


ROS_WHEELS = "pip install 'ros-jazzy-rclpy[fastrtps]==7.1.6' ros-jazzy-common-interfaces (Linux, x86-64)"
LIMITS = tuple(f"control.limits.{name}" for name in ("low", "high", "speed", "effort"))
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    add_parameter_arguments(parser, "motion, person and disturbance; see --list (default)")
    parser.add_argument("--list", action="store_true", help="print the scenarios with their meaning")
    parser.add_argument("--duration", type=float, metavar="S", help="simulated seconds (20)")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the sensor noise")
    parser.add_argument("--out", type=output, metavar="DIR", help="new bag (runs/SCENARIO-N)")
    parser.add_argument("--composed", action="store_true", help="all nodes in one process")
    parser.add_argument(
        "--legs",
        type=int,
        choices=(1, 2),
        default=1,
        help="2: left and right, half a cycle apart",
    )
    parser.add_argument(
        "--safety", action="store_true", help="with a safety monitor, in a process of its own"
    )
    parser.add_argument("--realtime", action="store_true", help="by the wall clock instead of in lockstep")
    parser.add_argument(
        "--no-plant", action="store_true", help="with a hardware driver in place of the emulated hardware"
    )
    parser.add_argument(
        "--open",
        action="store_true",
        help="keep ROS_DOMAIN_ID and the transport as they are set, so that other programs see the nodes"
        " (otherwise a free domain on the loopback device); always so with --no-plant",
    )
    parser.add_argument(
        "--watch", action="store_true", help="show it in the browser, at its pace, with an emergency stop"
    )
    add_model_argument(parser)
    add_verdict_arguments(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Run and judge; return 0 if the bound holds, 1 if not."""
    from pam_orthosis.bag.verdict import bound_in, judge_all  # what reads bags takes its time to load
    from pam_orthosis.model.device import parameters_of

    if arguments.list:
        print("\n".join(f"{name:24s} {meaning}" for name, meaning in scenario_names().items()))
        return 0
    need_ros()
    bound = bound_of(arguments)
    wanted = {"scenario.duration": arguments.duration, "scenario.seed": arguments.seed}
    wanted["control.limits.enabled"] = arguments.safety or None
    given = {key: value for key, value in wanted.items() if value is not None}
    parameters, mode = _chosen(arguments, given)
    for one in [parameters_of(own, parameters) for own in mode.legs.values()] or [parameters]:
        bound_in(bound, one.declared)
        check_controllable(one)
        _check_watched(one, assignments(arguments.param))
    with ExitStack() as stack:
        bag = claim(stack, arguments.out, arguments.scenario)
        run_graph(parameters, bag.resolve(), arguments.scenario, mode, arguments.open, arguments.watch)
    print(f"recorded {bag}", file=sys.stderr)
    return show(judge_all(bag, bound), arguments.json)


def _check_watched(parameters: Parameters, given: Mapping[str, Any]) -> None:
    """Raise OrthosisError if a safety monitor would watch a machine of one's own by the knee's limits."""
    from pam_orthosis.model.machines import shipped_machine, shipped_machines

    machine = parameters.declared
    shipped = machine.text in ("", *(shipped_machine(name).text for name in shipped_machines()))
    if shipped or not parameters.control.limits.enabled:
        return
    own, c = {*machine.values, *given}, machine.coordinate
    if missing := [key for key in LIMITS if key not in own]:
        raise OrthosisError(
            f"--safety: {', '.join(missing)} are the knee's; give those of the {machine.name} (in {c.unit},"
            f" {c.unit}/s and {c.effort_unit}) under values in its file, or by --param"
        )


def claim(stack: ExitStack, out: Path | None, scenario: str) -> Path:
    """Take a folder, a new or an empty one, for this run alone until the stack is closed; return it.

    Two runs may find the same folder empty: without `out` the second takes the next number. OrthosisError if
    the folder is used or cannot be made.
    """
    if out:
        stack.enter_context(claimed(out))
        return out
    while True:
        folder = _unused(scenario)
        with suppress(Used):
            stack.enter_context(claimed(folder))
            return folder


def need_ros() -> None:
    """Raise OrthosisError if there is no ROS."""
    if find_spec("rclpy") is None:
        raise OrthosisError(f"rclpy is not installed: source a ROS 2 installation, or {ROS_WHEELS}")


def _chosen(arguments: argparse.Namespace, given: Mapping[str, Any]) -> tuple[Parameters, launch.Mode]:
    """Return the parameters, those of the first joint of a device, and how the run is made."""
    from pam_orthosis.control.legs import device_parameters
    from pam_orthosis.model.device import device_named, entry_of
    from pam_orthosis.nodes.launch import Mode

    if arguments.no_plant and not arguments.realtime:
        raise OrthosisError("--no-plant: hardware does not wait for its controllers; give --realtime too")
    device = device_named(arguments.machine) if arguments.machine else None
    if device is None:
        parameters = with_model(chosen(arguments, given), arguments)
        return parameters, _mode(arguments, parameters)
    others = arguments.legs > 1, arguments.model, arguments.no_plant, arguments.watch
    if any(others) or arguments.scenario != DEFAULT:
        told = "--legs, --model, --no-plant, --watch and --scenario are for single machines"
        raise OrthosisError(f"{told}, not for {arguments.machine}; give its values by --param")
    if arguments.realtime and not arguments.composed:
        told = "give --composed too: nodes in processes of their own answer a device's samples too late"
        raise OrthosisError(f"--realtime with --machine {arguments.machine}: {told}")
    joints = device_parameters(device, {**given, **assignments(arguments.param)})
    legs = {name: entry_of(one) for name, one in joints.items()}
    return next(iter(joints.values())), Mode(
        arguments.composed, arguments.realtime, legs=legs, one_plant=True
    )


def _mode(arguments: argparse.Namespace, parameters: Parameters) -> launch.Mode:
    from pam_orthosis.control.legs import differences
    from pam_orthosis.model.machines import machine_named
    from pam_orthosis.nodes.launch import Mode

    if arguments.legs > 1 and not parameters.declared.experiments:
        shipped, other = machine_named().name, arguments.machine
        raise OrthosisError(f"--legs 2 is for the {shipped}, not for the machine of {other}")
    if arguments.legs > 1 and parameters.scenario.plan.enabled:
        raise OrthosisError("--legs 2: a plan is of one leg, the other is half a cycle ahead; leave it out")
    legs = differences(parameters) if arguments.legs > 1 else {}
    return Mode(arguments.composed, arguments.realtime, not arguments.no_plant, legs)


def _unused(scenario: str) -> Path:
    folders = (Path("runs") / f"{scenario}-{number}" for number in count(1))
    return next(folder for folder in folders if not folder.exists())


def run_graph(
    parameters: Parameters,
    bag: Path,
    scenario: str,
    mode: launch.Mode,
    visible: bool = False,
    watch: bool = False,
) -> None:
    """Run the nodes to the end of the scenario and record them into a new bag.

    `visible`: to other programs of the ROS domain; `watch`: with the live view. RunFailed if a node fails.
    """
    from pam_orthosis.nodes import launch  # --help needs none of it

    with tempfile.TemporaryDirectory(prefix="pam-orthosis-") as folder, ExitStack() as stack:
        work = Path(folder)
        if visible or not mode.with_plant:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            environment = launch.open_environment(work)
            launch.refuse_used_domain(domain, environment, mode, parameters.declared)
        else:
            free = stack.enter_context(launch.free_domain())
            domain, environment = str(free), launch.environment(work, free)
        commands = launch.commands(work, parameters, bag, scenario, mode)
        if watch:
            command = launch.view_command(work, parameters, mode.legs)
            stack.enter_context(watched(command, environment, work))
            commands = launch.paced(commands)
        with shown(f"ROS domain {domain}: starting the nodes") as progress:
            reached = simulated(progress, parameters.scenario.duration, domain)
            supervise_recorded(commands, environment, work, reached, bag)


def supervise_recorded(
    commands: Mapping[str, Sequence[str]],
    environment: Mapping[str, str],
    work: Path,
    progress: Callable[[int], None],
    bag: Path,
) -> None:
    """Supervise nodes that write a bag; RunFailed says what is left in it, which can be read then."""
    from pam_orthosis.nodes.supervisor import supervise  # --help needs none of it

    try:
        supervise(commands, environment, work, progress)
    except (RunFailed, KeyboardInterrupt) as error:
        raise RunFailed(f"{error or 'interrupted'}; {_rescue(bag, work)}") from None


def _rescue(bag: Path, work: Path) -> str:
    """Make what there is of a bag readable, keep the nodes' output beside it, say so."""
    from pam_orthosis.bag.bounded import open_bag
    from pam_orthosis.bag.information import METADATA_FILE
    from pam_orthosis.bag.recover import recover, recover_in_place
    from pam_orthosis.bag.unclosed import Damaged

    if not any(bag.glob("*.mcap")):
        return "nothing was recorded"
    readable, empty = bag, False
    try:
        if (bag / METADATA_FILE).exists():
            with open_bag(bag) as opened:
                empty = not opened.message_count
        else:
            try:
                recover_in_place(bag)
            except Damaged:
                readable = bag.with_name(f"{bag.name}-recovered")
                recover(bag, readable)
        left = "nothing was recorded" if empty else f"the bag {readable} holds the run up to there"
    except (OrthosisError, OSError) as error:
        left = str(error)
    with suppress(OSError):  # the disk may be full, which is perhaps why the run failed
        shutil.copytree(work, bag / "log", ignore=shutil.ignore_patterns("ros"))
        left += f"; logs in {bag / 'log'}"
    return left


def simulated(progress: Progress, duration_s: float, domain: int | str) -> Callable[[int], None]:
    """Return what takes the simulated time, ns, of nodes of a run."""
    reached = 0.0

    def advance(time_ns: int) -> None:
        nonlocal reached
        reached = max(reached, time_ns / SECOND_NS)  # nodes that have ended report none
        progress(f"ROS domain {domain}", reached, duration_s, " s")

    return advance


@contextmanager
def watched(command: Sequence[str], environment: Mapping[str, str], work: Path) -> Iterator[None]:
    """Show a run in the live view: its address, and the page where there is a display; else RunFailed."""
    log = work / "live_view.log"
    with beside(command, environment, log) as viewer:
        try:
            assert viewer.stdout
            if not (url := viewer.stdout.readline().strip()):
                raise RunFailed(f"the live view did not start: {last_words(log)}")
            print(f"live view: {url}", file=sys.stderr)
            if any(os.environ.get(name) for name in DISPLAYS):
                webbrowser.open(url)
            yield
        finally:
            viewer.terminate()
            with suppress(subprocess.TimeoutExpired):
                viewer.wait(5.0)


@contextmanager
def beside(
    command: Sequence[str], environment: Mapping[str, str], log: Path
) -> Iterator[subprocess.Popen[str]]:
    """Yield a node that no run waits for, whose output is read; it is killed in the end."""
    with (
        open(log, "wb") as errors,
        subprocess.Popen(
            command, env=dict(environment), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors,
            text=True,
        ) as node,
    ):  # fmt: skip
        try:
            yield node
        finally:
            node.kill()


def last_words(log: Path) -> str:
    """Return the last line of a log."""
    return (log.read_text(errors="replace").strip().splitlines() or ["it printed nothing"])[-1]
