# SPDX-License-Identifier: Apache-2.0
"""What is said of an effect that was found: parameters, evidence, what resembles it, what separates them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, scaled_slopes
from pam_orthosis.discrepancy.fitting.free import with_wider_shapes
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import Equation, System, Values
from pam_orthosis.model.parameters import Section

BLOCK = 1.0  # s
OF_SENSOR = 0.5  # of a wrong parameter's evidence, that a sensor in its place may lack
HIDDEN = 0.2  # power density over that of noise, less 1
QUANTILE = 1.96  # two-sided 95 % of a normal distribution


def covariance(problem: Problem, model: Fit) -> np.ndarray:
    """Return the covariance of the scaled free parameters: curvature, widened by the block sandwich.

    Scores are summed over blocks of 1 s; their scatter replaces the assumption of white residuals
    (Kauermann & Carroll 2001, clustered by time).
    """
    inverse = np.linalg.pinv(model.hessian)
    meat = np.zeros_like(inverse)
    for equation in problem.system.equations:
        slopes, place = scaled_slopes(model.blocks[equation.name], model.free)
        scores = slopes.T * model.blocks[equation.name].residual[:, None]
        sums = _over_blocks(problem, equation, scores)
        meat[np.ix_(place, place)] += sums.T @ sums
    sandwich = inverse @ meat @ inverse
    widening = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 1.0))
    return inverse * np.outer(widening, widening)


def deviations(system: System, model: Fit, spread: np.ndarray) -> np.ndarray:
    """Return the standard deviations of the free parameters, in their units; `spread`: their covariance.

    Shape corrections count with the next wider priors: what recordings do not show of them, they may hide.
    """
    priors = [
        np.array([one.scale / one.sd for one in free])
        for free in (model.free, with_wider_shapes(system, model.free))
    ]
    wider = np.linalg.pinv(model.hessian + np.diag(priors[1] ** 2 - priors[0] ** 2))
    ratio = np.diag(wider) / np.maximum(np.diag(np.linalg.pinv(model.hessian)), 1e-300)
    scale = np.array([one.scale for one in model.free])
    found: np.ndarray = scale * np.sqrt(np.diag(spread) * np.maximum(ratio, 1.0))
    return found


def interval(model: Fit, deviation: np.ndarray, name: str) -> tuple[float, float]:
    """Return the 95 % interval of a parameter, inside its bounds; `deviation`: of each free parameter."""
    index = [one.name for one in model.free].index(name)
    one, half = model.free[index], QUANTILE * float(deviation[index])
    value = model.values[name]
    return max(value - half, one.lower), min(value + half, one.upper)


def _over_blocks(problem: Problem, equation: Equation, scores: np.ndarray) -> np.ndarray:
    sums = []
    for one, part in problem.by_run(equation, scores):
        whole = max(1, one.samples // round(BLOCK / one.run.period))
        sums += [block.sum(axis=0) for piece in part for block in np.array_split(piece, whole)]
    return np.array(sums)


@dataclass(frozen=True)
class Named:
    """An effect that was found: parameters (name -> value, unit, lower, upper), evidence.

    `look_alikes` are effects that nothing separated from it when it was added, `separated_by` the experiments
    that would; `both` its size beside a look-alike that does as well with it, and that one's, with their
    units: its interval holds that size too. `at_bound` are parameters that a fit would take farther than they
    may go.
    """

    name: str
    equation: str
    parameters: Mapping[str, tuple[float, str, float, float]]
    evidence: float
    at_bound: tuple[str, ...] = ()
    look_alikes: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()
    both: Mapping[str, tuple[tuple[float, str], tuple[float, str]]] = field(default_factory=dict)


def named_effect(
    system: System, found: Selection, deviation: np.ndarray, name: str, settings: Section
) -> Named:
    """Return what is said of an effect of the final model; `deviation`: as in `interval`."""
    effect, final = system.catalogue[name], found.final
    parameters = {}
    known = {one.name for one in final.free}
    for q in effect.parameters:
        key = f"{name}.{q.name}"
        if key not in known:
            continue
        numbers = [final.values[key], *interval(final, deviation, key)]
        if own := system.recalibrating(name):  # they are deviations
            numbers = [float(own.applied(off)) for off in numbers]
        parameters[q.name] = numbers[0], q.unit, min(numbers), max(numbers)
    alike = _look_alikes(found, name, settings)
    tests = (test for one in (name, *alike) for test in system.experiments(one))  # its own first
    apart = tuple(dict.fromkeys(tests)) if alike else ()
    fitted = [q for q in effect.parameters if q.name in parameters]
    bound = tuple(q.name for q in fitted if q.at_bound(final.values[f"{name}.{q.name}"]))
    both = {
        other: (_size(system, name, values), _size(system, other, values))
        for other, values in found.both.get(name, {}).items()
        if other in alike
    }
    for (beside, _), _ in both.values():  # the interval of a size holds what it may be with another effect
        size = effect.fitted[0].name
        value, unit, lower, upper = parameters[size]
        parameters[size] = value, unit, min(lower, beside), max(upper, beside)
    return Named(name, system.equation_of(name), parameters, found.evidence[name], bound, alike, apart, both)


def _size(system: System, name: str, values: Values) -> tuple[float, str]:
    size = system.catalogue[name].fitted[0]
    return values[f"{name}.{size.name}"], size.unit


def first_accepted(found: Selection, named: Sequence[Named]) -> Named | None:
    """Return the effect that was accepted first of those that stayed."""
    order = [_step_of(found, one.name) for one in named]
    return named[order.index(min(order))] if named else None


def _step_of(found: Selection, name: str) -> int:
    """Return the number of the step that added an effect, be it beside the one that it accepted."""
    return next(
        number
        for number, step in enumerate(found.steps)
        if step.accepted and (step.accepted == name or (step.fit and name in step.fit.effects))
    )


def _round_of(found: Selection, name: str) -> tuple[float, Sequence[tuple[str, float]]]:
    """Return the evidence of an effect when it was accepted, and those of its round that are not named.

    The best effect of a round may have been refused, and the next one accepted. A round in silence ranks
    by evidence of its own. What changes another equation explains something else, however near it comes.
    """
    step = found.steps[_step_of(found, name)]
    own = dict(step.ranked).get(name, step.evidence)
    others = [item for item in step.ranked if item[0] not in found.final.effects]
    return own, [item for item in others if _meet(found.problem, name, item[0])]


def _meet(problem: Problem, one: str, other: str) -> bool:
    """Return whether two effects change an equation in common; a late sensor drives the others' too."""
    catalogue, touched = problem.system.catalogue, problem.replay.touched
    late = any(catalogue[name].advance is not None for name in (one, other))
    return late or bool(touched(one) & touched(other))


def runner_up_of(found: Selection) -> tuple[str, float] | None:
    """Return the best effect with evidence that the first round did not choose, and how far behind it was."""
    accepted = [step.accepted for step in found.steps if step.accepted in found.final.effects]
    own, others = _round_of(found, str(accepted[0])) if accepted else (0.0, ())
    behind = [(name, own - evidence) for name, evidence in others if evidence > 0]
    return min(behind, key=lambda item: item[1]) if behind else None


def _look_alikes(found: Selection, name: str, settings: Section) -> tuple[str, ...]:
    """Return the effects that were near in evidence when one was accepted, but for those that are named."""
    own, others = _round_of(found, name)
    alike = [
        other
        for other, evidence in others
        if own - evidence < max(settings.ambiguous, _share(found, name, other, settings) * own)
    ]
    first = [
        *found.both.get(name, {}),
        *(_taken_by(found, name) if name in found.problem.system.shapes else ()),
    ]
    both = [other for other in first if other not in found.final.effects]
    return tuple(dict.fromkeys([*both, *alike]))


def _share(found: Selection, name: str, other: str, settings: Section) -> float:
    """Return the share of an effect's evidence by which another one that is no worse may be behind."""
    system = found.problem.system
    if name not in system.wrong:
        return float(settings.ambiguous_share)
    # the form of a wrong parameter is the model's own: it costs no evidence; that of a sensor may, and where
    # recalibration leaves noise, tolerances alone decide between the two
    return OF_SENSOR if system.catalogue[other].stage == "sensor" and _is_hidden(found, name) else 0.0


def _is_hidden(found: Selection, name: str) -> bool:
    """Return whether recalibration alone leaves hardly more than noise where an effect acts."""
    weights = (found.problem.weights[one] for one in found.problem.replay.touched(name))
    return all(1 / weight**2 - 1 < HIDDEN for weight in weights)


def _taken_by(found: Selection, shape: str) -> list[str]:
    """Return the effects that were dropped and may be what a shape correction does in their place."""
    return [name for name in found.dropped if _meet(found.problem, shape, name)]


def in_all(system: System, one: Named) -> str:
    """Return in words what a delay beside the model's own comes to; empty for what counts from nothing."""
    effect = system.catalogue[one.name]
    if effect.late is None:
        return ""
    known = system.late + system.later.get(effect.late_of, 0.0)
    if not known:
        return ""
    delay = known + one.parameters[effect.fitted[0].name][0]
    return f" beside the {1e3 * known:.3g} ms that the model has ({1e3 * delay:.2f} ms in all)"
