# SPDX-License-Identifier: Apache-2.0
"""Count the work of lockstep steps: calls of the package's functions, messages, memory that is kept.

python counted.py FIRST_STEP LAST_STEP NODE... --ros-args ...   prints what was counted in between as JSON

What the wall clock triggers is left out, and so are comprehensions, which are calls in some versions of
Python only. What is counted then depends on the steps alone.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path

import pam_orthosis

ROOT = Path(pam_orthosis.__file__).parent
BY_THE_WALL_CLOCK = {"watch", "_watch", "_look", "acknowledge", "_on_recorded"}


class Counting:
    """Counts calls between two marks, by module of the package."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self.published = self.handed_on = 0
        self.blocks: list[int] = []
        self._on = False
        self._left_out = 0
        self._modules: dict[object, str | None] = {}

    def mark(self) -> None:
        """Begin to count, or end."""
        self._on = not self._on
        self.blocks.append(sys.getallocatedblocks())

    def __call__(self, frame, event, _argument) -> None:
        """Take an event of the interpreter."""
        if event not in ("call", "return"):
            return
        code = frame.f_code
        if code.co_name in BY_THE_WALL_CLOCK and self._module(code):
            self._left_out += 1 if event == "call" else -1
        elif event == "call" and self._on and not self._left_out:
            self._count(code)

    def _count(self, code) -> None:
        module = self._module(code)
        if module:
            self.calls[module] += 1
            self.handed_on += module == "nodes/exchange.py" and code.co_name == "post"
        elif code.co_name == "publish" and code.co_filename.endswith("rclpy/publisher.py"):
            self.published += 1

    def _module(self, code) -> str | None:
        if code not in self._modules:
            path = Path(code.co_filename)
            own = ROOT in path.parents and not code.co_name.endswith(("comp>", "genexpr>"))
            self._modules[code] = str(path.relative_to(ROOT)) if own else None
        return self._modules[code]

    def per_step(self, steps: int) -> dict:
        """Return what was counted, for each of so many steps."""
        calls = {module: round(count / steps, 3) for module, count in sorted(self.calls.items())}
        return {
            "calls": calls,
            "published": self.published / steps,
            "handed_on": self.handed_on / steps,
            "kept_blocks": (self.blocks[1] - self.blocks[0]) / steps,
        }


def count_graph(first: int, last: int) -> dict:
    """Run the composed graph of the command line; return its work in each step between two."""
    from pam_orthosis.nodes import composed, pace

    counting, answered = Counting(), pace.Lockstep._answered

    def marked(self, stamp_ns, *voltages):
        if stamp_ns // self._plant.period_ns in (first, last):
            counting.mark()
        answered(self, stamp_ns, *voltages)

    pace.Lockstep._answered = marked
    sys.setprofile(counting)
    status = composed.main()
    sys.setprofile(None)
    assert status == 0
    return counting.per_step(last - first)


def count_loop(first: int, last: int) -> dict:
    """Return the work in each step of the closed loop without ROS between two."""
    from pam_orthosis.control.loop import ClosedLoop
    from pam_orthosis.model.parameters import load

    loop, counting = ClosedLoop(load()), Counting()
    for index in range(last):
        if index == first:
            counting.mark()
            sys.setprofile(counting)
        loop.step(index)
    sys.setprofile(None)
    counting.mark()
    return counting.per_step(last - first)


if __name__ == "__main__":
    first, last = (int(sys.argv.pop(1)) for _ in range(2))
    print(json.dumps(count_graph(first, last)))
