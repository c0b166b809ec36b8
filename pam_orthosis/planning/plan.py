# SPDX-License-Identifier: Apache-2.0
"""Plan a cycle within the reach of the actuators: where it gives way, and co-contraction ahead of need."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.control.axis import Axis
from pam_orthosis.control.effects import AddedEffort
from pam_orthosis.control.position import Demand, pressures_for_effort
from pam_orthosis.control.reference import Reference
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import rounded
from pam_orthosis.model.rules import FARTHEST_PLAN, motion_digest
from pam_orthosis.planning import RESERVE
from pam_orthosis.planning.problem import HELPS, Array, Cycle, NotFound, nearest_cycle
from pam_orthosis.planning.recorded import Recorded
from pam_orthosis.progress import Progress, silent

NODES = 200  # of a cycle
_PHASES = np.arange(NODES) / NODES
_MIDDLES = _PHASES + 0.5 / NODES
_NEAR_REST = np.cos(np.pi * _PHASES) ** 16  # 1 at the phase of rest, within a tenth of a cycle nearly 0
LEAD = 0.02  # s by which the machine is late where valves are at their limits, and more is asked for earlier
EARLY = 0.75  # of a cycle behind the start, where most gaits ask for most: there the first one is planned


@dataclass(frozen=True)
class Plan:
    """What was planned: duration of the cycle, s, wanted coordinate, (N,) rad or m, and the planned cycle.

    `asked` is the coordinate that is asked for so that the planned one is made, (N,). `made_for` is the
    digest of the motion. `early` is the planned cycle at the start, if it differs: creep takes `settling`
    cycles, by a factor e, to find its own.
    """

    cycle_time: float
    wanted: Array
    cycle: Cycle
    asked: Array
    made_for: str = ""
    early: Cycle | None = None
    settling: float = 1.0

    @property
    def overrides(self) -> dict[str, Any]:
        """Return the parameters that let the trajectory publisher ask for the plan."""
        changed: dict[str, Any] = {"scenario.plan.enabled": True, "scenario.plan.cycle_time": self.cycle_time}
        changed["scenario.plan.made_for"] = self.made_for
        changed |= _rows("scenario.plan", self.asked - self.wanted, self.cycle.mean_pressure)
        if self.early:
            changed |= _rows("scenario.plan.start", *self._at_the_start(self.early))
            changed["scenario.plan.start.settling"] = rounded([self.settling])[0]
        return changed

    @property
    def farthest(self) -> float:
        """Return the largest distance of the planned motion from the wanted one, rad or m."""
        if not self.early:
            return self.cycle.largest
        begun = self.cycle.position - self.wanted + self._at_the_start(self.early)[0]
        return max(self.cycle.largest, float(np.abs(begun).max()))

    def _at_the_start(self, early: Cycle) -> tuple[Array, Array]:
        """Return by what coordinate and mean pressure, Pa, differ at the start."""
        growth = np.exp(EARLY / self.settling)  # it has died away by so much where it is planned
        settled, then = self.cycle.mean_pressure, early.mean_pressure
        both = np.append(settled, then)
        mean = np.clip(settled + growth * (then - settled), both.min(), both.max())
        return growth * (early.position - self.cycle.position), mean - settled


def _rows(group: str, angle: Array, pressure: Array) -> dict[str, list[float]]:
    rows = {}
    for name, values in (("angle", angle), ("pressure", pressure)):
        rows[f"{group}.{name}.cosine"], rows[f"{group}.{name}.sine"] = fourier(values)
    return rows


def fourier(values: Array) -> tuple[list[float], list[float]]:
    """Return the cosine and sine coefficients of a cycle at equidistant phases, the mean first."""
    harmonics = 24  # as many as the rows of `scenario.plan` have coefficients
    spectrum = np.fft.rfft(values)[: harmonics + 1] / len(values)
    spectrum[1:] *= 2
    return rounded(spectrum.real), rounded(-spectrum.imag)


def make_plan(
    parameters: Parameters,
    reserve: float = RESERVE,
    progress: Progress = silent,
    recorded: Recorded | None = None,
) -> Plan:
    """Return the plan of the scenario's cycle by the controllers' nominal model.

    Args:
        reserve: by how much supply and highest pressure are lower than in that model, Pa.
        recorded: what a run of it showed: the effort missing in the model is planned for, the search begins
            at the cycle that was made, and by what it fell short of an earlier plan more is asked for.

    Raises:
        OrthosisError: the scenario has no cycle, or no motion was found that the actuators can make.
    """
    nominal = _with_reserve(parameters.nominal(), reserve)
    trajectory = make_trajectory(nominal)
    if not isinstance(trajectory, Trajectory):
        raise OrthosisError(f"{nominal.scenario.trajectory} has no cycle to plan: take gait, sine or steps")
    position, velocity, acceleration = _cycle(trajectory, nominal)
    progress("searching the nearest motion")
    mean = np.full(NODES, nominal.control.position.mean_pressure)
    starts = [
        _unhurried(nominal, position, velocity, acceleration),
        Cycle(position, np.array([mean, mean]), 0.0),
    ]
    missing = np.zeros(NODES)
    if recorded:
        pressures = np.array([series(_PHASES) for series in recorded.pressures])
        starts = [Cycle(recorded.position(_PHASES), pressures, 0.0), *starts]
        missing = recorded.missing(_MIDDLES)
    search = partial(
        _nearest, nominal, position=position, velocity=velocity, missing=missing, progress=progress
    )
    cycle = search(starts)
    _check_near(nominal, cycle.largest)
    asked = cycle.position + (_fell_short(recorded, nominal.scenario.cycle_time) if recorded else 0.0)
    settling, early = along(nominal, position, velocity, cycle).settling, None
    if settling:
        with suppress(NotFound):  # then the start is asked for what the settled cycle is
            early = search([cycle], start_of_run=True)
    made_for = motion_digest(nominal.flat())
    plan = Plan(nominal.scenario.cycle_time, position, cycle, asked, made_for, early, settling or 1.0)
    _check_near(nominal, plan.farthest)
    return plan


def _check_near(nominal: Parameters, away: float) -> None:
    if away >= FARTHEST_PLAN:
        shown = nominal.declared.coordinate.shown(away, ".0f")
        found = f"the nearest motion found is {shown} away from the wanted one"
        raise OrthosisError(f"{found}; {HELPS}")


def _nearest(
    nominal: Parameters,
    starts: list[Cycle],
    position: Array,
    velocity: Array,
    missing: Array,
    progress: Progress,
    start_of_run: bool = False,
) -> Cycle:
    """Return the nearest cycle found, with the first share of the flow with which there is one."""
    period, shown = nominal.scenario.cycle_time / NODES, nominal.declared.coordinate.shown

    def found(share: float, start: Cycle) -> Cycle:
        effects = along(nominal, position, velocity, start)
        effort = (effects.early if start_of_run else effects.settled) + missing
        cycle = nearest_cycle(nominal, start, position, velocity, effort, period, share)
        progress(f"searching the nearest motion, so far within {shown(cycle.largest)}")
        return cycle

    # of what an open valve passes: who is late cannot catch up with all of it, the last resort
    shares = 0.9, 1.0
    return _first(lambda share: _settled(partial(found, share), starts), shares)


def _settled(found: Callable[[Cycle], Cycle], starts: list[Cycle]) -> Cycle:
    """Return what is found from one of the starts, and then from what was found before."""
    cycle = _first(found, starts)
    rounds = 4  # at most: the effects' effort depends on the pressures, and these on it
    settled = 1.0e-3  # rad or m by which another round does not change the result any more
    for _ in range(rounds - 1):
        before = cycle
        with suppress(NotFound):  # what was found before is a motion too
            cycle = found(before)
        if abs(cycle.largest - before.largest) < settled:
            break
    return cycle


def _first(found: Callable[[Any], Cycle], options: Sequence[Any]) -> Cycle:
    """Return what is found with the first option that leads to a cycle."""
    *earlier, last = options
    for option in earlier:
        with suppress(NotFound):
            return found(option)
    return found(last)


def _with_reserve(nominal: Parameters, reserve: float) -> Parameters:
    limits = "valve.supply_pressure", "control.position.maximum_pressure"
    values = nominal.flat()
    return nominal.changed({key: values[key] - reserve for key in limits} | {"scenario.plan.enabled": False})


def _cycle(trajectory: Trajectory, nominal: Parameters) -> tuple[Array, ...]:
    """Return coordinate, velocity, acceleration at the nodes of a cycle from its start, at full cadence."""
    s = nominal.scenario
    covered = 0.5 * s.start_ramp / s.cycle_time  # in cycles, when the ramp is over
    start = s.start_hold + s.start_ramp + (np.ceil(covered) - covered) * s.cycle_time
    instants = start + np.arange(NODES) * s.cycle_time / NODES
    references = [trajectory.sample(round(instant * 1e9))[:3] for instant in instants]
    return tuple(np.array(each) for each in zip(*references, strict=True))


def _unhurried(nominal: Parameters, position: Array, velocity: Array, acceleration: Array) -> Cycle:
    """Return the wanted cycle with the pressures that it takes, as if valves could give any at once."""
    q, rate, wanted = (ca.SX.sym(name) for name in ("q", "rate", "wanted"))
    axis, mean = Axis(nominal), nominal.control.position.mean_pressure
    terms = axis.terms(q, rate)
    effort = terms.inertia * wanted + terms.coriolis + terms.gravity
    found = pressures_for_effort(Demand(effort, q, rate, mean), axis)
    law = ca.Function("unhurried", [q, rate, wanted], list(found.pressures))
    gauge = law(*(each.reshape(1, -1) for each in (position, velocity, acceleration)))
    pressures = [np.array(each).ravel() + nominal.valve.ambient_pressure for each in gauge]
    return Cycle(position, np.array(pressures), 0.0)


def _fell_short(recorded: Recorded, cycle_time: float) -> Array:
    """Return by what the machine fell short of a plan, `LEAD` earlier; nothing where it rests.

    Nothing either of a run without a plan: the actuators may not be able to make that motion.
    """
    later = _PHASES + LEAD / cycle_time
    short = recorded.planned * (recorded.followed(later) - recorded.position(later))
    return np.asarray(short - short[0] * _NEAR_REST)


class Effort(NamedTuple):
    """Torque or force of the nominal model's effects between the N instants of a cycle, (N,) each.

    Attributes:
        settled: when creep has found its cycle.
        early: in the first cycle, begun from long rest; the same if nothing creeps.
        settling: cycles in which the difference falls by a factor e; None: there is none.
    """

    settled: Array
    early: Array
    settling: float | None


def along(nominal: Parameters, position: Array, velocity: Array, cycle: Cycle) -> Effort:
    """Return the effort of the effects along a motion, (N,) and its rate, at the pressures of a cycle."""
    step, count = nominal.scenario.control_period, len(position)
    samples = round(nominal.scenario.cycle_time / step)
    at, middles = np.arange(samples) * count / samples, (np.arange(count) + 0.5) / count

    def between(values: Array) -> Array:
        return np.asarray(np.interp(at, np.arange(count + 1), np.append(values, values[0])))

    columns = position, velocity, *cycle.pressures
    rows, law = list(zip(*map(between, columns), strict=True)), AddedEffort(nominal)

    def of_a_cycle() -> Array:
        effort = [law.step(Reference(q, rate, 0.0), (first, second)) for q, rate, first, second in rows]
        return np.asarray(np.interp(middles * samples, np.arange(samples + 1), [*effort, effort[0]]))

    of_a_cycle()  # dry friction and play find their cycle in it
    cycles = [of_a_cycle(), of_a_cycle()]
    same_effort = 1.0e-2  # N m or N by which it may differ from one cycle to the next
    longest = 60  # cycles after which it is taken for settled
    while np.abs(cycles[-1] - cycles[-2]).max() > same_effort and len(cycles) < longest:
        cycles.append(of_a_cycle())
    settled = cycles[-1]
    second, third = (each - settled for each in cycles[:2])
    left = float(second @ third) / float(second @ second) if len(cycles) > 2 else 0.0  # a cycle later
    if not 0.0 < left < 1.0:
        return Effort(settled, settled, None)
    settling = -1.0 / np.log(left)
    return Effort(settled, settled + second * np.exp((1.0 + middles - EARLY) / settling), settling)
