# SPDX-License-Identifier: Apache-2.0
"""Does a system fit together? The engine relies on it; a user's mistake is to be named before a search."""

import math
from collections import Counter
from collections.abc import Iterable
from itertools import chain
from types import SimpleNamespace
from typing import Any

import casadi as ca

from pam_orthosis.bag.fields import check_field
from pam_orthosis.bag.topics import Signal
from pam_orthosis.discrepancy.systems.cut import closure
from pam_orthosis.discrepancy.systems.neutral import remains
from pam_orthosis.discrepancy.systems.system import Assembled, Calibration, Channel, Entry, Equation, System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import EQUATIONS, Effect, Quantity

STAMPS = "time"  # as tables have them


def check_system(system: System) -> None:
    """Check that a system fits together, with each of its effects alone.

    Raises:
        OrthosisError: what does not.
    """
    _check_signals(system)
    _check_calibrations(system)
    for name, effect in system.catalogue.items():
        _check_effect(system, name, effect)
    _check_equations(system)
    _check_places(system)
    _check_derived_twice(system)
    for channel, entries in system.entries.items():
        _known("entries", channel, [one.name for one in system.channels if one.state is not None])
        _all(entries, Entry, f"entries of {channel}")
        for entry in entries:
            _check_entry(system, f"entries of {channel}", entry)
    bare = _check_expressions(system, ())
    for name, effect in system.catalogue.items():
        found = _check_expressions(system, (name,))
        _check_shows(system, name, found)
        _check_neutral(system, effect, bare, found)


def _check_neutral(system: System, effect: Effect, bare: Assembled, found: Assembled) -> None:
    """Check that an effect without size is none; a dead time has states, and a wrong value counts from 0."""
    if effect.shape or effect.late is not None or effect.name in system.wrong:
        return
    neutral = [f"{q.name} = {q.neutral:g}" for q in effect.parameters if q.neutral is not None]
    if neutral and remains(system, effect, bare, found):
        raise OrthosisError(
            f"effect {effect.name}: it does not vanish at {' and '.join(neutral)}, said to be neutral"
        )


def _check_signals(system: System) -> None:
    _all(system.channels, Channel, "channels")
    channels = [one.name for one in system.channels]
    check_free(channels, system.inputs)
    _once("channels and inputs", [*channels, *system.inputs])
    if not channels:
        raise OrthosisError("a system needs one channel at least: nothing is measured")
    for one in system.channels:
        _finite(f"channel {one.name}: report_factor", one.report_factor)
        if one.report_factor == 0:
            raise OrthosisError(f"channel {one.name}: report_factor is 0")
    for name, sd in system.input_noise.items():
        _known("input_noise", name, system.inputs)
        _finite(f"noise of {name}", sd, 0.0)
    _finite("late", system.late)
    for name, seconds in system.later.items():
        _known("later", name, system.inputs)
        _finite(f"later of {name}", seconds)
    _finite("ambient", system.ambient, math.ulp(0.0))
    for kind, names in (("gradual", system.gradual), ("sensed", system.sensed)):
        for name in names:
            _known(kind, name, system.inputs)
    for name, ends in system.limits.items():
        _known("limits", name, (*channels, *system.inputs))
        _check_limits(name, ends)
    for name, source in system.sources.items():
        _known("sources", name, (*channels, *system.inputs, STAMPS))
        _finite(f"source of {name}: factor", source.factor)
        _finite(f"source of {name}: offset", source.offset)
        if source.factor == 0:
            raise OrthosisError(f"source of {name}: factor is 0")
        if source.topic:
            check_field(Signal(name, source.topic, source.field, source.joint, "", type=source.type))


def _check_limits(name: str, ends: Any) -> None:
    pair = isinstance(ends, tuple | list) and len(ends) == 2
    if not pair or not all(isinstance(end, int | float) for end in ends):
        raise OrthosisError(f"limits of {name}: {ends!r}; give the lowest and the highest value, (low, high)")
    low, high = ends
    if not low < high:
        raise OrthosisError(f"limits of {name}: {low} is not below {high}")


def check_free(channels: Iterable[str], inputs: Iterable[str]) -> None:
    """Check that no signal is called as the stamps of a table; OrthosisError: one is."""
    for what, names in (("channel", channels), ("input", inputs)):
        if STAMPS in names:
            raise OrthosisError(
                f"{what} {STAMPS!r}: a table has its stamps under this name; give it another one (`sources`"
                " says which column it is)"
            )


def _check_calibrations(system: System) -> None:
    _all(system.calibrations, Calibration, "calibrations")
    _once("parameters", [one.name for one in system.calibrations])
    for one in system.calibrations:
        _finite(f"tolerance of {one.name}", one.sd, math.ulp(0.0))
        _finite(f"nominal value of {one.name}", one.nominal)


def _check_effect(system: System, name: str, effect: Effect) -> None:
    if not isinstance(effect, Effect) or effect.name != name:
        raise OrthosisError(f"the catalogue has under {name!r} something else than an Effect of this name")
    where = f"effect {name}"
    _once(f"{where}: parameters", [q.name for q in effect.parameters])
    for q in effect.parameters:
        _check_quantity(f"{where}: {q.name}", q)
    if not effect.fitted:
        raise OrthosisError(f"{where}: none of its parameters is fitted")
    if effect.shape and any(not q.prior for q in effect.parameters):
        raise OrthosisError(f"{where}: each parameter of a shape correction needs a prior")
    if effect.scales and len(effect.scales) != len(effect.states):
        raise OrthosisError(f"{where}: {len(effect.scales)} scales of {len(effect.states)} states")
    _check_names(system, where, effect)


def _check_names(system: System, where: str, effect: Effect) -> None:
    own = [q.name for q in effect.parameters]
    for key in chain(*effect.starts):
        _known(f"{where}: starts", key, own)
    for key in effect.periodic or ():
        _known(f"{where}: periodic", key, own)
    typical = SimpleNamespace(**{q.name: q.typical for q in effect.parameters})
    for channel in effect.advance(typical) if effect.advance else ():
        _known(f"{where}: advance", channel, [one.name for one in system.channels])


def _check_quantity(where: str, q: Quantity) -> None:
    for value in (q.typical, q.minimum, q.maximum):
        _finite(where, value)
    if not q.minimum <= q.typical <= q.maximum or q.minimum == q.maximum:
        raise OrthosisError(f"{where}: {q.typical} is not inside its bounds {q.minimum} .. {q.maximum}")
    if q.neutral is not None and not q.minimum <= q.neutral <= q.maximum:
        raise OrthosisError(f"{where}: neutral {q.neutral} is outside its bounds {q.minimum} .. {q.maximum}")
    if q.typical == q.neutral:
        raise OrthosisError(f"{where}: its typical value is the neutral one, at which there is no effect")


def _check_equations(system: System) -> None:
    if not system.equations:
        raise OrthosisError("a system needs one equation at least: there is nothing to replay")
    _all(system.equations, Equation, "equations")
    _once("equations", [one.name for one in system.equations])
    _once("channels of equations", [name for one in system.equations for name in one.channels])
    measured = {one.state for one in system.channels if one.state is not None}
    for rate, state in system.derived.items():
        if state not in measured or rate in measured:
            raise OrthosisError(
                f"derived: {rate!r} has to be a state that is not measured, {state!r} one that is"
            )
    for equation in system.equations:
        for name in equation.channels:
            _known(f"equation {equation.name}", name, [one.name for one in system.channels])
            _check_gains(system, equation, system.channel(name))
        if not equation.states:
            raise OrthosisError(f"equation {equation.name}: no channel shows a state, nothing holds a replay")
        for state in equation.states:
            _known(f"equation {equation.name}: states", state, [*measured, *system.derived])


def _check_places(system: System) -> None:
    equations = [one.name for one in system.equations]
    called = {*equations, *system.equation_names, *EQUATIONS.values()}
    for name, place in system.places.items():
        _known("places", name, system.catalogue)
        _known(f"place of {name}", place, [*equations, *system.equation_names])
    for name, effect in system.catalogue.items():
        if name not in system.places:
            _known(f"effect {name} without one of `places`: stage", effect.stage, EQUATIONS)
    for name, inputs in system.needs.items():
        _known("needs", name, called)
        for one in inputs:
            _known(f"needs of {name}", one, system.inputs)


def _check_derived_twice(system: System) -> None:
    measured = Counter(one.state for one in system.channels)
    rates = Counter(system.derived.values())
    for bent, state in system.derived_twice.items():
        if bent in measured or bent in system.derived or not measured[state] == rates[state] == 1:
            raise OrthosisError(
                f"derived_twice: {bent!r} has to be a state that is neither measured nor derived,"
                f" {state!r} one that one channel measures, with one rate in `derived`"
            )


def _check_entry(system: System, where: str, entry: Entry) -> None:
    _finite(f"{where}: size", entry.size)
    if entry.size == 0:
        raise OrthosisError(f"{where}: size is 0")
    name, _, own = entry.parameter.partition(".")
    if name in system.catalogue:
        _known(f"{where}: parameter of {name}", own, [q.name for q in system.catalogue[name].parameters])


def _check_gains(system: System, equation: Equation, channel: Channel) -> None:
    if channel.state is None:
        return
    rates = [rate for rate, state in system.derived.items() if state == channel.state]
    gains = equation.gains.get(channel.name, {})
    for state in (channel.state, *rates):
        if state not in gains or state not in equation.states:
            raise OrthosisError(
                f"equation {equation.name} predicts {channel.name}: it needs the state {state} and its gain"
            )
    for state, gain in gains.items():
        _finite(f"equation {equation.name}: gain of {state}", gain, 0.0)


def _check_expressions(system: System, effects: tuple[str, ...]) -> Assembled:
    """Check the expressions with some effects on; return them."""
    found = system.assemble(effects)
    where = f"with {' and '.join(effects)}" if effects else "without effects"
    own = tuple(f"{name}.{q.name}" for name in effects for q in system.catalogue[name].parameters)
    if found.parameters != (*(one.name for one in system.calibrations), *own):
        raise OrthosisError(
            f"{where}: the parameters are not those of calibrations and effects, in this order"
        )
    sizes = {
        "states": (found.x, len(found.states)),
        "rates": (found.rates, len(found.states)),
        "inputs": (found.u, len(system.inputs)),
        "parameters": (found.theta, len(found.parameters)),
    }
    for what, (vector, expected) in sizes.items():
        if vector.numel() != expected:
            raise OrthosisError(f"{where}: {vector.numel()} {what}, not {expected}")
    for channel in system.channels:
        if channel.name not in found.measured:
            raise OrthosisError(f"{where}: nothing is measured as {channel.name}")
    measured = [one.state for one in system.channels if one.state is not None]
    for state in (*measured, *system.derived, *system.derived_twice):
        _known(f"{where}: states", state, found.states)
    results = ca.vertcat(found.rates, *found.measured.values())
    given = ca.vertcat(found.x, found.u, found.time, found.theta)
    free = {str(one) for one in ca.symvar(results)} - {str(one) for one in ca.symvar(given)}
    if free:
        raise OrthosisError(
            f"{where}: expressions have the symbol {min(free)}, which is no state, input or parameter"
        )
    if _has_nan(given, results):
        raise OrthosisError(
            f"{where}: a constant in the expressions is no number (NaN); Python's `math` takes no signals or"
            " parameters: write ca.tanh, ca.exp and so on (import casadi as ca)"
        )
    return found


def _has_nan(given: ca.SX, results: ca.SX) -> bool:
    """Return whether NaN is in expressions: what `float` makes of a symbol."""
    steps = ca.Function("steps", [given], [results])
    constants = (i for i in range(steps.n_instructions()) if steps.instruction_id(i) == ca.OP_CONST)
    return any(math.isnan(steps.instruction_constant(i)) for i in constants)


def _check_shows(system: System, name: str, found: Assembled) -> None:
    """Check that an effect changes what is predicted."""
    first = len(system.calibrations)
    for equation in system.equations:
        own = closure(system, found, equation)
        rates = [found.rates[found.states.index(state)] for state in own]
        results = ca.vertcat(*rates, *(found.measured[channel] for channel in equation.channels))
        if any(i >= first for i in ca.jacobian_sparsity(results, found.theta).get_col()):
            return
    raise OrthosisError(f"effect {name}: nothing that is predicted depends on its parameters")


def _all(items: Iterable[Any], kind: type, what: str) -> None:
    for one in items:
        if not isinstance(one, kind):
            raise OrthosisError(f"{what}: {one!r} is no {kind.__name__}")


def _once(what: str, names: Iterable[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise OrthosisError(f"{what}: {name!r} is there {count} times")


def _known(what: str, name: str, names: Iterable[str]) -> None:
    if name not in names:
        raise OrthosisError(f"{what}: {name!r} is none of {', '.join(names) or 'no names'}")


def _finite(what: str, value: float, least: float = -math.inf) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise OrthosisError(f"{what}: {value!r} is no finite number")
    if value < least:
        raise OrthosisError(f"{what}: {value} is not {'above' if least else 'at least'} 0")
