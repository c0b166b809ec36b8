# SPDX-License-Identifier: Apache-2.0
"""How much work a step is, in counts: a slow-down is noticed on a machine of any speed and load.

`work_budget.json` holds what was counted. Who adds work on purpose counts anew:
`python test/nodes/test_work.py` writes the file.
"""

import json
import subprocess
import sys
from pathlib import Path

import counted
import pytest

from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch

BUDGET = Path(__file__).with_name("work_budget.json")
FIRST, LAST = 40, 90
GRAPHS = {"graph": 1, "graph_at_two_rates": 5}  # every how many control periods the position controller works
MORE_CALLS = 0.5  # of a module's functions in a step: less than one call more
MORE_PUBLISHED = 0.25  # acknowledgements come by the wall clock too
MORE_BLOCKS = 40


def count_graph(work, every=1):
    """Return the work of a control period of the composed graph, recorder included."""
    duration = (LAST + 10) * load().scenario.control_period
    parameters = load({"scenario.duration": duration, "control.position.every": every})
    with launch.free_domain() as domain:
        made = launch.commands(work, parameters, work / "bag", "default", launch.Mode(composed=True))
        ((python, _, _, _, *rest),) = made.values()
        command = [python, counted.__file__, str(FIRST), str(LAST), *rest]
        environment = launch.environment(work, domain)
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=600, check=False
        )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def exceeded(told, budget):
    """Return what is more than its budget, as text."""
    over = [
        f"{module}: {calls:g} calls a step, budget {budget['calls'].get(module, 0):g}"
        for module, calls in told["calls"].items()
        if calls > budget["calls"].get(module, 0) + MORE_CALLS
    ]
    for what, more in (
        ("published", MORE_PUBLISHED),
        ("handed_on", MORE_PUBLISHED),
        ("kept_blocks", MORE_BLOCKS),
    ):
        if told[what] > budget[what] + more:
            over.append(f"{what}: {told[what]:g} a step, budget {budget[what]:g}")
    return over


def test_a_step_of_the_loop_is_no_more_work_than_it_was():
    assert exceeded(counted.count_loop(FIRST, LAST), json.loads(BUDGET.read_text())["loop"]) == []


@pytest.mark.parametrize(("name", "every"), GRAPHS.items())
def test_a_step_of_the_graph_is_no_more_work_than_it_was(tmp_path, name, every):
    pytest.importorskip("rclpy")
    assert exceeded(count_graph(tmp_path, every), json.loads(BUDGET.read_text())[name]) == []


def test_one_needless_call_a_step_is_noticed(monkeypatch):
    from pam_orthosis.control import guarded

    step = guarded.GuardedPosition.step

    def twice(self, *arguments):
        self.health()
        return step(self, *arguments)

    monkeypatch.setattr(guarded.GuardedPosition, "step", twice)
    over = exceeded(counted.count_loop(FIRST, LAST), json.loads(BUDGET.read_text())["loop"])
    assert over
    assert any("control/guarded.py" in one for one in over)


if __name__ == "__main__":
    import tempfile

    found = {"loop": counted.count_loop(FIRST, LAST)}
    for name, every in GRAPHS.items():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = count_graph(Path(folder), every)
    BUDGET.write_text(json.dumps(found, indent=1) + "\n")
    sys.exit(0)
