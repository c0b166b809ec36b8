# SPDX-License-Identifier: Apache-2.0
"""The last line of what the workflow found: the verdict in words."""

from collections.abc import Mapping

from pam_orthosis.discrepancy.answer.between import stamped_late
from pam_orthosis.discrepancy.answer.digits import in_short
from pam_orthosis.discrepancy.answer.judgement import (
    FAR_STRAIN,
    NEAR,
    Outcome,
    beyond,
    moved_beyond,
    off,
    shares_moved,
)
from pam_orthosis.discrepancy.answer.unknown_words import short, unannounced
from pam_orthosis.discrepancy.fitting.measure import OVERALL, over_noise
from pam_orthosis.discrepancy.fitting.structure import clean
from pam_orthosis.discrepancy.recordings.data import TOO_OLD
from pam_orthosis.discrepancy.search.confirmation import at_values
from pam_orthosis.discrepancy.search.findings import Named
from pam_orthosis.discrepancy.search.selection import Ranking
from pam_orthosis.discrepancy.systems.system import System, Values

MOST_RIVALS = 3  # of an effect
NOISE = "noise only is left"
MASSES, PERSON = "moving_mass", "person_mass"  # without a person masses act by their ratio to the forces
HIDES, MOST_HIDING = 5.0, 3  # times the noise, of the nominal model; tolerances that may hide it
NOTABLE = 10.0  # evidence that is worth a word though no name: where nothing is hidden, the best one has less


def far(strained: Mapping[str, float]) -> bool:
    """Return whether a nuisance parameter is far off its tolerance."""
    return max(map(abs, strained.values()), default=0.0) > FAR_STRAIN


def _refusal(outcome: Outcome) -> str:
    """Return why nothing is named: else the reason of the first round, if there was a candidate."""
    if outcome.surrogates:
        return "no model of the catalogue explains half of the gap"
    step = outcome.steps[0] if outcome.steps else None
    if step is None or step.accepted is not None or not step.ranked:
        return "nothing in the catalogue fits"
    return f"no effect is added (best: {step.ranked[0][0]}): {step.reason}"


def last_line(outcome: Outcome) -> str:
    """Return the verdict with what it rests on."""
    names = " and ".join(with_rivals(outcome.system, one) for one in outcome.effects)
    share = outcome.closure[OVERALL]
    explain = "explain" if len(outcome.effects) > 1 else "explains"
    much = f"{explain}{'' if share is None else f' {100 * share:.1f} % of the gap'}"
    left, but = f"{_rest(outcome)}{_emptied(outcome)}", "but" if _rest(outcome) == NOISE else "and"
    bent = f", {but} nuisance parameters are far outside their tolerance" if far(outcome.strained) else ""
    if outcome.mistaken:
        maybe = f"{names or 'recalibration'} may only make up for it"
        return f"{outcome.verdict.upper()}: {outcome.mistaken}; {maybe}"
    if outcome.skewed and outcome.effects:
        return f"PARTIAL: {names} {much}, but stamps seem off: mend them and search again (see the remark)"
    words = {
        "none": _none(outcome) if outcome.verdict == "none" else "",
        "recalibrated": _recalibrated(outcome, names) if outcome.verdict == "recalibrated" else "",
        "explained": f"by {names}",
        "partial": f"{names} {much}; {left}{bent}{_nearest(outcome)}",
        "described": _described(outcome, names),
        "unexplained": _unexplained(outcome, left, bent),
    }[outcome.verdict]
    return f"{outcome.verdict.upper()}{' ' if outcome.verdict == 'explained' else ': '}{words}"


def _rest(outcome: Outcome) -> str:
    """Return how much is left, and in which equation most."""
    kept = over_noise(outcome.system, outcome.after, outcome.floor)
    worst = max(kept, key=lambda name: kept[name])
    if kept[worst] <= NEAR and clean(outcome.left) and not beyond(outcome.after, outcome.floor):
        return NOISE
    if kept[worst] <= NEAR and (far_off := off_words(outcome)):
        return far_off
    if kept[worst] <= NEAR and not clean(outcome.left):
        most = max(outcome.left, key=lambda one: one.density)
        return f"what is left in the {most.equation} equation is small, but more than noise"
    return f"in the {worst} equation {kept[worst]:.1f} times the noise is left"


def off_words(outcome: Outcome) -> str:
    """Return which channel is furthest off in its unit, if one is."""
    times = off(outcome.after, outcome.floor)
    worst = max(times, key=lambda name: times[name], default="")
    return f"{worst} is {times[worst]:.1f} times as far off as noise alone leaves it" if worst else ""


def _recalibrated(outcome: Outcome, names: str) -> str:
    if names:
        return f"by {names}; recalibration could take all of it too, with parameters further off"
    moved = _moved(outcome, moved_beyond(outcome.system, outcome.selection.final))
    return f"the model leaves noise only with {moved}{_nearest(outcome)}"


def _nearest(outcome: Outcome) -> str:
    """Return the best effect of the rounds after what is named, if it came near, and what it lacks."""
    steps, named = list(outcome.steps), {one.name for one in outcome.effects}
    last = max((k for k, step in enumerate(steps) if step.accepted in named), default=-1)
    near = [step for step in steps[last + 1 :] if step.ranked]
    if not near or (best := max(near, key=lambda step: step.ranked[0][1])).ranked[0][1] < NOTABLE:
        return ""
    name, evidence = best.ranked[0]
    sensors = _sensors_beside(outcome.system, name, best.ranked)
    return f"; nearest to a name is {name} (evidence {evidence:.0f}{sensors}): {best.reason}"


def _sensors_beside(system: System, name: str, ranked: Ranking) -> str:
    """Return the sensors with evidence that is not much less than a wrong parameter's: it may be theirs."""
    least = max(0.0, ranked[0][1] - NOTABLE)
    others = {one: evidence for one, evidence in ranked if evidence > least} if name in system.wrong else {}
    sensors = [one for one in others if system.catalogue[one].stage == "sensor"]
    return "".join(f", or {one} {others[one]:.0f}" for one in sensors)


def _none(outcome: Outcome) -> str:
    """Return that recalibration leaves noise, and what it moved furthest: an effect may act like that."""
    moved = moved_beyond(outcome.system, outcome.selection.final, least=1.0)
    most = max(moved, key=lambda name: abs(moved[name]), default="")
    furthest = f"; it moved furthest: {_moved(outcome, {most: moved[most]})}" if most else ""
    words = f"recalibrated within its tolerances, the model leaves noise only{furthest}"
    return f"{words}{_hiding(outcome)}{_nearest(outcome)}"


def _hiding(outcome: Outcome) -> str:
    """Return in which tolerances a gap may hide, where recalibration takes a large one away."""
    gap = outcome.configured.white[OVERALL] / outcome.floor.white[OVERALL]
    moved = shares_moved(outcome.selection.final)
    names = sorted((name for name in moved if moved[name] > 1), key=lambda name: -moved[name])[:MOST_HIDING]
    if gap < HIDES or not names:
        return ""
    listed = ", ".join(name.replace("_", " ") for name in names)
    return (
        f"; the nominal model leaves {gap:.0f} times the noise: if the tolerances of {listed} are wider than"
        " what is known, they may hide a gap"
    )


def _moved(outcome: Outcome, moved: Values) -> str:
    """Return how far parameters were moved, in multiples of how far they were stated to be off."""
    words, values = [], outcome.selection.final.values
    known = {one.name: one for one in outcome.system.calibrations}
    by_ratio = () if PERSON in known else (MASSES,)
    for name, times in moved.items():
        off, one = values[name], known.get(name)
        size = f" {float(one.applied(off)) - one.nominal:+.3g} {one.unit} off" if one else ""
        size = f" {1 + off:.3g} times as large" if one and one.relative else size
        size += f" (or all forces {1 / (1 + off):.3g} times)" if name in by_ratio else ""
        words.append(f"{name}{size} ({abs(times):.1f} times its tolerance)")
    return ", ".join(words)


def _described(outcome: Outcome, names: str) -> str:
    if outcome.unknown is None:
        return names
    what, equation = short(outcome.system, outcome.unknown), outcome.unknown.equation
    before = f"{outcome.kept[equation]:.1f} without it"
    left = f"leaves {outcome.left_unknown:.1f} times the noise in the {equation} equation ({before})"
    return f"{names + ', and ' if names else ''}{what}; a description, no cause, which {left}"


def with_rivals(system: System, one: Named) -> str:
    """Return what was found, with what the recordings do not separate from it."""
    rivals = [
        f"or {in_short(one.both[name][0])} with {_title(system, name)}"
        if name in one.both
        else f"or {_title(system, name)}"
        for name in one.look_alikes[:MOST_RIVALS]
    ]
    return _title(system, one.name) + (f" ({', '.join(rivals)})" if rivals else "")


def _title(system: System, name: str) -> str:
    return f"a wrong {system.wrong[name]}" if name in system.wrong else name.replace("_", " ")


def _unexplained(outcome: Outcome, left: str, bent: str) -> str:
    if stamps := _of_stamps(outcome, left):
        return stamps
    if outcome.foreign:
        return (
            "nothing I know; something large is missing, or the recordings are of another machine than the"
            f" given one; {left}{bent}"
        )
    if clean(outcome.left) and not beyond(outcome.after, outcome.floor) and far(outcome.strained):
        return "noise only is left, but by nuisance parameters far outside their tolerance"
    if clean(outcome.left) and beyond(outcome.after, outcome.floor):
        gap = off_words(outcome) or f"the gap is {outcome.after.white[OVERALL]:.1f} times the noise"
        return (
            f"the held-out recordings leave what was fitted ({gap}), though other parameters would follow"
            " them; fit recordings that reach as far, or something is missing that acts as these do"
        )
    if outcome.unknown and outcome.unknown.events:
        pushes, system = outcome.unknown, outcome.system
        return f"{left}; {short(system, pushes)}; {unannounced(system, pushes)}"
    return left if outcome.empty else f"{left}; {_refusal(outcome)}"


def _of_stamps(outcome: Outcome, left: str) -> str:
    """Return that stamps are to be mended before anything else, if they are."""
    if late := stamped_late(outcome.system, outcome.steps):
        mend = "mend the stamps"
        if any(TOO_OLD in one for one in outcome.remarks):
            period = outcome.system.input_period
            mend = f"is the loop faster than they change, and are they {TOO_OLD}? Give {period}, or {mend},"
        return f"{late[0]}; {mend} and search again; {left}"
    if not outcome.skewed:
        return ""
    final = outcome.selection.final
    keys = [one.name for one in final.free if one.name.partition(".")[0] in final.effects]
    beside = f"with {at_values(outcome.system, final, keys)} {left}"
    return f"stamps seem off: mend them and search again (see the remark); {beside}"


def _emptied(outcome: Outcome) -> str:
    """Return which effects of the model are not what their names say, if any is not."""
    if not outcome.empty:
        return ""
    names = dict.fromkeys(key.partition(".")[0] for key in outcome.empty)
    listed = at_values(outcome.system, outcome.selection.final, outcome.empty)
    return f"; {' and '.join(names)} would not be what the name says ({listed})"
