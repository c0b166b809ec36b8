# SPDX-License-Identifier: Apache-2.0
"""What each controller is asked: trajectories and people, on specimens of the hardware."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pam_orthosis.model.parameters import scenario_overrides

SPECIMENS = 10
FEW = 3  # specimens of the further trajectories and people
SEED = 1  # of the sensor noise
RECORDED_SEED = 2  # of that in the run that a plan is made after: 20 s, as `pam-orthosis run` makes it
PEERS = ("pid", "proxy_sliding_mode", "adrc")  # of `control.position.controller`
CONTROLLERS = ("paper", *PEERS, "learned", "calm", "planned", "replanned")
CALM = {"control.observer.pole": 80.0}  # 1/s: a learned model leaves the observer less to find out


class Case(NamedTuple):
    """A task: name, scenario, what is set beside it, duration s, whether all specimens are asked.

    `otherwise`: the nominal model of the specimen does not hold of these parameters in this task.
    `contact`: a person pushes or blocks; what is felt counts, and the laws by name are asked.
    """

    name: str
    scenario: str
    changes: Mapping[str, Any] = {}
    duration: float = 9.0
    everywhere: bool = False
    otherwise: tuple[str, ...] = ()
    contact: bool = False

    def overrides(self) -> dict[str, Any]:
        """Return the parameters that make the task."""
        return scenario_overrides(self.scenario) | self.changes

    @property
    def wearer(self) -> str:
        """The scenario whose gains and wearer it has: default or person."""
        return "person" if self.scenario.startswith("person") else "default"


def _sine(hertz: float, amplitude: float, duration: float) -> Case:
    changes = {"scenario.cycle_time": 1 / hertz, "scenario.sine.amplitude": amplitude}
    return Case(f"sine {hertz:g} Hz, {57.2958 * amplitude:.0f} deg", "sine", changes, duration)


# the regulator is turned up to what the configuration says
FULL_SUPPLY = {"plant.deviation.supply_pressure": 1.0}
PUSH = 10.0  # N m
PUSHED = {
    **FULL_SUPPLY, "scenario.trajectory": "hold", "scenario.start_angle": 0.6, "plant.external_torque": PUSH,
    "plant.external_frequency": 0.5,
}  # fmt: skip
# nobody releases the joint: what the law does is to be seen
BLOCK = {"plant.person.block.start": 4.4, "plant.person.block.duration": 1.5}  # s, before the swing
BLOCKED = {
    **FULL_SUPPLY,
    **BLOCK,
    "control.guard.tracking_error": 3.0,
    "control.guard.velocity_error": 1000.0,
}
SUPPLY = ("valve.supply_pressure", "control.position.maximum_pressure")

CASES = (
    Case("gait 2 s", "default", everywhere=True),
    Case("gait 2 s, 75 kg", "person", everywhere=True),
    Case("gait 2 s, 75 kg, begun bent", "person-bent", everywhere=True),
    Case("gait 2 s, 75 kg, supply of 7 bar", "person", FULL_SUPPLY, everywhere=True, otherwise=SUPPLY),
    Case("push", "person", PUSHED, 7.0, everywhere=True, contact=True),
    Case("block", "person-passive", BLOCKED, everywhere=True, contact=True),
    Case("gait 1.25 s", "gait-fast", duration=7.0),
    Case("gait 4 s", "gait-slow", duration=13.0),
    Case("gait of an adult", "gait-adult"),
    Case("gait of children", "gait-children"),
    Case("steps of 34 deg", "steps", duration=10.0),
    _sine(0.1, 0.3, 16.0),
    _sine(0.5, 0.3, 9.0),
    _sine(1.0, 0.3, 7.0),
    _sine(2.0, 0.1, 6.0),
    Case("gait, p_im 4.6 bar", "default", {"control.position.mean_pressure": 4.6e5}),
    Case("gait 1.25 s, 75 kg", "person", {"scenario.cycle_time": 1.25}, 7.0),
    Case("gait 4 s, 75 kg", "person", {"scenario.cycle_time": 4.0}, 13.0),
    Case("gait, 45 kg", "person-light"),
    Case("gait, 110 kg", "person-heavy"),
    Case("gait, 75 kg, resisting", "person-resisting"),
    Case("gait, 75 kg, spastic", "person-spastic"),
)  # fmt: skip


def plan() -> Iterator[tuple[int, Case]]:
    """Yield specimen and case: what all specimens are asked first, then the rest specimen by specimen.

    Specimen 0 is the hardware of the shipped configuration, 1 to `SPECIMENS` are drawn.
    """
    for specimen in range(SPECIMENS + 1):
        yield from ((specimen, case) for case in CASES if case.everywhere)
    for specimen in range(FEW + 1):
        yield from ((specimen, case) for case in CASES if not case.everywhere)
