# SPDX-License-Identifier: Apache-2.0
"""The graph in one process with a position controller that asks for nonsense: a program for tests.

Its first argument is what nonsense; the others are those of `pam_orthosis.nodes.entry`.
"""

import math
import random
import sys

from pam_orthosis.bag.topics import POSITION
from pam_orthosis.control.position import PositionCommand

LOW, HIGH, NAN = 1.2e5, 6.6e5, math.nan
HELD = 25  # steps, of what is drawn


class Nonsense:
    """Stands in for the guarded position controller."""

    latched = ""

    def __init__(self, kind):
        self._kind, self._count, self._drawn = kind, 0, random.Random(1)
        self._pressures = self._draw()

    def health(self):
        return {}

    def retune(self, parameters):
        pass

    def released(self):
        return ""

    def reset(self):
        pass

    def _draw(self):
        return tuple(self._drawn.choice([0.0, LOW, HIGH, 1e9]) for _ in range(2))

    def step(self, position, *_others):
        self._count += 1
        if self._kind == "random" and not self._count % HELD:
            self._pressures = self._draw()
        asked = {"full": (LOW, HIGH), "stuck": (5e5, 3e5), "nan": (NAN, NAN)}.get(self._kind, self._pressures)
        place = NAN if self._kind == "nan" else position
        return PositionCommand(asked, place, 0.0, 0.0, 0.0, False, False)


if __name__ == "__main__":
    from pam_orthosis.nodes import composed, position_controller

    class NonsenseController(position_controller.PositionControllerNode):
        """The node with its topics and without its controller."""

        def configure(self):
            super().configure()
            self._controller = Nonsense(kind)

    kind = sys.argv.pop(1)
    composed.NODES[POSITION] = NonsenseController
    sys.argv.pop(1)
    sys.exit(composed.main())
