# SPDX-License-Identifier: Apache-2.0
"""Print tracking with a position controller slower than the others, seed 1.

Run `python benchmarks/rates.py`; it prints Markdown.
"""

import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters

SECONDS = 12.0
SCENARIOS = ("default", "person", "gait-fast")
RATES = ((0.005, 1), (0.002, 1), (0.002, 2), (0.002, 3), (0.002, 5), (0.005, 2), (0.002, 10), (0.005, 4))
COMPARED = ((0.002, 5), (0.002, 10))


class Between:
    """A pressure controller with another notion of what holds between the position controller's steps."""

    def __init__(self, controller, held_s, estimate_goes_on, reference_goes_on):
        self._controller, self._held_s = controller, held_s
        self._estimate_goes_on, self._reference_goes_on = estimate_goes_on, reference_goes_on
        self._reference, self._slope = None, 0.0

    def step(self, pressure, reference, angle, velocity, periods=1, age=0.0):
        """Return the mass flow, kg/s."""
        if not age:
            before = reference if self._reference is None else self._reference
            self._slope, self._reference = (reference - before) / self._held_s, reference
        reference += age * self._slope * self._reference_goes_on
        return self._controller.step(
            pressure, reference, angle, velocity, periods, age * self._estimate_goes_on
        )


def measure(scenario, period, every, *goes_on):
    """Return maximum and RMS error, deg, and the voltage variation of both valves, V/s."""
    overrides = {"scenario.control_period": period, "control.position.every": every}
    loop = ClosedLoop(parameters.load({**parameters.scenario_overrides(scenario), **overrides}), seed=1)
    if goes_on:
        for guarded in loop._pressure:
            guarded._controller = Between(guarded._controller, every * period, *goes_on)
    run = loop.run(round(SECONDS / period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    variation = [np.abs(np.diff(run[f"{m}_voltage"])).sum() / SECONDS for m in ("extensor", "flexor")]
    return np.abs(error).max(), np.sqrt(np.mean(error**2)), *variation


def row(*told):
    """Print a row of a table."""
    print("|", " | ".join(told), "|", flush=True)


def shown(largest, rms, extensor, flexor):
    """Return what was measured as text."""
    return f"{largest:.2f} / {rms:.2f} deg, {extensor:.0f}, {flexor:.0f} V/s"


def main():
    """Print the tables."""
    row("pressure", "position", *SCENARIOS)
    row(*["---"] * (2 + len(SCENARIOS)))
    for period, every in RATES:
        found = [shown(*measure(scenario, period, every)) for scenario in SCENARIOS]
        row(f"{1 / period:.0f} Hz", f"{1 / period / every:.3g} Hz", *found)
    print()
    row("position", "estimate", "pressure reference", *SCENARIOS)
    row(*["---"] * (3 + len(SCENARIOS)))
    for period, every in COMPARED:
        for goes_on in ((True, False), (False, False), (True, True)):
            words = ["goes on" if one else "held" for one in goes_on]
            found = [shown(*measure(scenario, period, every, *goes_on)) for scenario in SCENARIOS]
            row(f"{1 / period / every:.3g} Hz", *words, *found)


if __name__ == "__main__":
    main()
