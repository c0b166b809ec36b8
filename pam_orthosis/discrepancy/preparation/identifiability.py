# SPDX-License-Identifier: Apache-2.0
"""What these recordings can identify: which effects would show in them, and which would look alike.

Each effect's signature is what its typical size changes in the residuals, less what the nuisance
parameters would follow of it. Its square is the evidence to expect; the angle between two of them
says whether they can be separated.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import Trial, penalty
from pam_orthosis.discrepancy.fitting.fit import Fit, normal_equations
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Block, Problem
from pam_orthosis.discrepancy.systems.system import Names, System
from pam_orthosis.progress import Progress, silent

ALIKE = 0.95  # cosine of two signatures above which they are one
LITTLE = 0.1  # information of recordings on a change of parameters over that of their tolerances
TAKES_PART = 0.01  # square of a parameter's share in such a change


class Astray(NamedTuple):
    """An effect with which equations give no finite number, at its typical size; `always`: at no size."""

    name: str
    equations: Names
    always: bool


@dataclass(frozen=True)
class Identifiability:
    """What recordings can and cannot identify.

    Attributes:
        evidence: effect -> evidence to expect if it had its typical size.
        invisible: effects whose typical size would not be noticed.
        alike: pairs of visible effects with the cosine of their signatures.
        experiments: scenarios that show or separate most of these, best first.
        together: parameters of a system of one's own that may change together without a trace.
        hidden: effects that change nothing in the equations that recordings can judge.
        missing: inputs that the other equations need, and that a recording lacks.
        astray: effects with which recordings give no finite number; these are not `invisible`.
    """

    evidence: dict[str, float]
    invisible: tuple[str, ...]
    alike: tuple[tuple[str, str, float], ...]
    experiments: tuple[str, ...]
    together: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    astray: tuple[Astray, ...] = ()


def identifiability(
    problem: Problem,
    model: Fit,
    threshold: float,
    progress: Progress = silent,
    whole: System | None = None,
    missing: Names = (),
) -> Identifiability:
    """Return what recordings can identify, seen from a recalibrated model; `threshold` of evidence.

    What is wrong with the model at present is no property of the recordings: each residual counts fully.
    `whole`: the system with the equations, if any, that need inputs which are `missing`.
    """
    problem, model = untempered(problem, model)
    projection, whole = Projection(problem, model), whole or problem.system
    known = {*model.effects, *whole.wrong}
    names = problem.replay.touching(name for name in problem.system.candidates if name not in known)
    trials = [Trial(projection, name) for name in names]
    gram, astray = _gram(projection, trials, progress)
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    evidence = {
        trial.name: float(g**2 - penalty(model, len(trial.free)))
        for trial, g in zip(trials, size, strict=True)
    }
    unknown = {one.name for one in astray}
    invisible = tuple(name for name in names if evidence[name] < threshold and name not in unknown)
    cosine = gram / np.maximum(np.outer(size, size), 1e-300)
    alike = tuple(
        (a, b, float(abs(cosine[i, j])))
        for i, a in enumerate(names)
        for j, b in enumerate(names[:i])
        if abs(cosine[i, j]) > ALIKE and not {a, b} & {*invisible, *unknown}
    )
    experiments = _experiments(problem.system, invisible, alike)
    hidden = tuple(name for name in whole.candidates if name not in {*names, *known})
    return Identifiability(
        evidence,
        invisible,
        alike,
        experiments,
        together(problem.system, model),
        hidden,
        missing,
        astray,
    )


def together(system: System, model: Fit) -> tuple[str, ...]:
    """Return the parameters that take part in changes of which recordings tell less than tolerances do.

    What recordings do not show alone, as an offset of what only changes, is none of them.
    """
    candidates = [one.name for name in system.wrong if (one := system.recalibrating(name))]
    free = [one for one in model.free if one.name in candidates]
    hessian, _ = normal_equations(model.blocks, free, model.values)
    sizes = np.array([one.sd / one.scale for one in free])
    # of the recordings alone, by parameters in tolerances
    information = hessian * np.outer(sizes, sizes) - np.eye(len(free))
    seen = np.flatnonzero(np.diag(information) > LITTLE)
    if len(seen) < 2:
        return ()
    told, directions = np.linalg.eigh(information[np.ix_(seen, seen)])
    share = np.sum(directions[:, told < LITTLE] ** 2, axis=1)
    return tuple(free[i].name for i, part in zip(seen, share, strict=True) if part > TAKES_PART)


def untempered(problem: Problem, model: Fit) -> tuple[Problem, Fit]:
    """Return the problem and its fit with the weights taken away by which a gap tempers the residuals."""
    blocks = {
        name: Block(b.residual / b.weight, b.slopes / b.weight, b.names) for name, b in model.blocks.items()
    }
    return problem.weighted(dict.fromkeys(problem.weights, 1.0)), replace(model, blocks=blocks)


def _gram(
    projection: Projection, trials: list[Trial], progress: Progress
) -> tuple[np.ndarray, tuple[Astray, ...]]:
    """Return the inner products of the signatures with the nuisance parameters projected out.

    Beside them the effects of which there is no signature.
    """
    level = projection.best(*projection.state({}))[1]
    base = projection.base.blocks
    rows = {name: np.zeros((len(trials), len(block.residual))) for name, block in base.items()}
    shared = np.zeros((len(projection.position), len(trials)))

    def seen(trial: Trial) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], Astray]:
        first, *others = trial.starts()
        residuals = trial.residuals(first)
        astray = _endless(residuals)
        changes = {n: r - base[n].residual for n, r in residuals.items() if n not in astray}
        always = bool(astray) and all(_endless(trial.residuals(one)) for one in others)
        known = {name: (change, projection.correlated(name, change)) for name, change in changes.items()}
        return known, Astray(trial.name, astray, always)

    replay = projection.problem.replay
    signatures = replay.workers.forked(seen, trials, replay, progress, "computing what these data can show")
    for i, (of_trial, _) in enumerate(signatures):
        for name, (change, correlated) in of_trial.items():
            rows[name][i] = change
            shared[:, i] += correlated
    total: Any = sum(row @ row.T for row in rows.values())
    gram: np.ndarray = total - shared.T @ level.solve(shared)
    return gram, tuple(one for _, one in signatures if one.equations)


def _endless(residuals: Mapping[str, np.ndarray]) -> Names:
    return tuple(name for name, row in residuals.items() if not np.isfinite(row).all())


def _experiments(
    system: System, invisible: Sequence[str], alike: Sequence[tuple[str, str, float]]
) -> tuple[str, ...]:
    wanted = [*invisible, *(name for a, b, _ in alike for name in (a, b))]
    votes = Counter(test for name in wanted for test in system.experiments(name))
    return tuple(name for name, _ in votes.most_common())
