# SPDX-License-Identifier: Apache-2.0
"""Feed the samples of a recorded bag to the nodes again, and compare their answers with the recorded ones."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_orthosis.bag.topics import SECOND_NS, Signal, Topics
from pam_orthosis.cli.check import titled
from pam_orthosis.cli.parameters import assignments
from pam_orthosis.cli.run import need_ros, simulated, supervise_recorded
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import claimed, output
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.progress import Shown, shown

if TYPE_CHECKING:
    from pam_orthosis.bag.compare import TopicComparison
    from pam_orthosis.model.machine import Machine


SAMPLING = ("control.position.every", "scenario.control_period")  # which instants have inputs depends on them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder or file")
    parser.add_argument(
        "--node",
        action="append",
        default=[],
        metavar="NAME",
        help="node to feed (repeatable; all)",
    )
    parser.add_argument("--namespace", metavar="NS", help="namespace of the leg in the bag (all legs)")
    parser.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set a parameter to another value than in the recorded run (repeatable)",
    )
    parser.add_argument("--out", type=output, metavar="DIR", help="keep the answers, as a new bag")
    parser.add_argument("--json", action="store_true", help="print the comparison as JSON")


def execute(arguments: argparse.Namespace) -> int:
    """Print the comparison; return 0 if all answers are there and equal but for rounding, 1 if not."""
    from pam_orthosis.bag.legs import namespaces  # what reads bags takes its time to load
    from pam_orthosis.bag.read import recorded_machine

    need_ros()
    legs = namespaces(arguments.bag) if arguments.namespace is None else [arguments.namespace]
    if arguments.out and len(legs) > 1:
        raise OrthosisError(f"--out holds one leg: give --namespace, one of {', '.join(legs)}")
    claim = claimed(arguments.out) if arguments.out else nullcontext()
    with claim, shown(f"reading {arguments.bag}") as progress:
        replayed = {leg.strip("/"): _replay(arguments, leg, progress) for leg in legs}
    compared = [one for topics in replayed.values() for one in topics]
    whole = all(one.whole for one in compared)
    same = whole and all(one.same for one in compared)
    if arguments.json:
        identical = whole and all(one.identical for one in compared)
        print(json.dumps({"identical": identical, "same": same, "legs": _by_leg(replayed)}, indent=2))
    else:
        signals = {leg: Topics(recorded_machine(arguments.bag, leg)).signals for leg in replayed}
        tables = (titled(leg, _table(topics, signals[leg])) for leg, topics in replayed.items())
        print("\n\n".join(tables))
        print(_answer(compared))
    return 0 if same else 1


def _by_leg(replayed: Mapping[str, Sequence[TopicComparison]]) -> dict[str, list[dict[str, Any]]]:
    return {
        leg: [asdict(one) | {"identical": one.identical, "same": one.same} for one in topics]
        for leg, topics in replayed.items()
    }


def _replay(arguments: argparse.Namespace, namespace: str, progress: Shown) -> list[TopicComparison]:
    from pam_orthosis.bag.compare import compare
    from pam_orthosis.bag.read import recorded_machine, recorded_parameters, run_record
    from pam_orthosis.bag.script import Script, held_ns
    from pam_orthosis.bag.topics import asked_beside
    from pam_orthosis.nodes import launch
    from pam_orthosis.nodes.supervisor import supervise

    bag = arguments.bag.resolve()
    recorded = recorded_parameters(bag, run_record(bag, namespace), namespace)
    parameters = _parameters(recorded, recorded_machine(bag, namespace), arguments.param, progress)
    script = Script(bag, namespace, arguments.node, held_ns(parameters), asked_beside(parameters))
    if not recorded:
        progress.note("the bag holds no parameters: the nodes take the shipped ones")
    for node, topic in script.missing.items():
        if topic:
            progress.note(f"{node} is not fed: {topic} is missing in the bag")
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-") as folder, ExitStack() as stack:
        work = Path(folder)
        answers = arguments.out.resolve() if arguments.out else work / "answers"
        player = {"bag": launch.as_parameter(bag), "directory": launch.as_parameter(answers)}
        player["namespace"] = namespace
        domain = stack.enter_context(launch.free_domain())
        stamps = script.messages["joint_states"]
        progress(f"ROS domain {domain}: starting the nodes")
        reached = simulated(progress, (max(stamps) - min(stamps)) / SECOND_NS, domain)
        commands = launch.replay_commands(work, parameters, script.nodes, player, _leg(bag, namespace))
        environment = launch.environment(work, domain)
        if arguments.out:
            supervise_recorded(commands, environment, work, reached, answers)
        else:
            supervise(commands, environment, work, reached)
        progress("comparing the answers")
        topics = [topic for node in script.nodes for topic in script.outputs(node)]
        return compare(bag, answers, topics, namespace)


def _leg(bag: Path, namespace: str) -> str:
    """Return the name of the leg if it was one of several, else nothing."""
    from pam_orthosis.bag.read import legs_of, run_record

    name = namespace.strip("/")
    return name if name in legs_of(bag, run_record(bag)) else ""


def _parameters(
    recorded: Mapping[str, Any], machine: Machine, changes: Sequence[str], progress: Shown
) -> Parameters:
    """Return the parameters of the recorded run, as far as this version knows them, with changes."""
    known = load({}, machine).flat()
    if unknown := sorted(recorded.keys() - known.keys()):
        progress.note(f"recorded by another version: it has no {', '.join(unknown)}")
    kept = {key: value for key, value in recorded.items() if key in known}
    made = load(kept | assignments(changes), machine)
    wanted = made.flat()
    for key in SAMPLING:
        if recorded and wanted[key] != (was := recorded.get(key, known[key])):
            raise OrthosisError(f"{key}: the bag holds inputs for {was} only; run the scenario anew")
    return made


def _answer(compared: Sequence[TopicComparison]) -> str:
    if not all(one.same for one in compared):
        return "DIFFERENT"
    scarce = [one for one in compared if not one.whole]
    if not scarce:
        return "IDENTICAL" if all(one.identical for one in compared) else _rounding(compared)
    one, recorded = scarce[0], scarce[0].compared + scarce[0].alone
    return f"INCOMPLETE: of {one.topic} {one.compared} of {recorded} answers could be compared"


def _rounding(compared: Sequence[TopicComparison]) -> str:
    one = max(compared, key=lambda each: each.rounding)
    by = f"by at most {one.rounding:.1g} of a signal's largest value, in {one.topic}"
    return f"IDENTICAL but for rounding, {by} (another processor, or another version)"


def _table(topics: Sequence[TopicComparison], signals: Mapping[str, Signal]) -> str:
    rows = [f"{'topic':28s} {'compared':>8s} {'equal':>8s} {'rounded':>8s} {'alone':>6s}  largest difference"]
    for one in topics:
        counts = f"{one.compared:8d} {one.equal:8d} {one.rounded:8d} {one.alone:6d}"
        rows.append(f"{one.topic:28s} {counts}  {_differences(one, signals)}".rstrip())
    return "\n".join(rows)


def _differences(one: TopicComparison, signals: Mapping[str, Signal]) -> str:
    largest = [f"{name} {value:.3g} {signals[name].unit}" for name, value in one.differences.items() if value]
    if largest or one.identical:
        return ", ".join(largest) or "none"
    return "in what is no signal" if one.compared else "nothing to compare"
