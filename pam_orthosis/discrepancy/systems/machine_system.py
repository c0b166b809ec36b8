# SPDX-License-Identifier: Apache-2.0
"""Any machine as a system of the gap workflow: its nominal model, and how far that may be off."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca

from pam_orthosis.bag.topics import Topics
from pam_orthosis.discrepancy.systems.boxes import boxes
from pam_orthosis.discrepancy.systems.suspects import common, corrected, meant, name_of, suspects
from pam_orthosis.discrepancy.systems.system import Assembled, Calibration, Channel, Entry, Equation, System
from pam_orthosis.discrepancy.systems.view import Symbols, View
from pam_orthosis.model.assembly import Hardware, assemble
from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.effects.base import Effect, enabled
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import NOMINAL, Parameters
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals

MOTION = "angle", "velocity", "acceleration"
PUSH = "constant_torque.torque"  # by which an unknown torque enters
VOLTS, SHARE = 0.02, 0.05  # changes of a voltage and of a valve's gain that show what they do
SMALL = 0.2  # of a typical size, which is a knee's: where a search starts too
ONSET = 0.5  # N, up to which a muscle's damping grows


def nominal_parameters(machine: Machine, parameters: Parameters) -> Parameters:
    """Return what the nominal model of a machine may know: no plant."""
    return machine.taken(parameters).only(*NOMINAL, "rig", "gap")


def machine_system(
    machine: Machine,
    parameters: Parameters,
    view: Callable[[Machine, Parameters], View],
    catalogue: Mapping[str, Effect] | None = None,
    external: bool = False,
) -> System:
    """Return a machine as its parameters describe it; `plant` is not read.

    Args:
        machine: of which the recordings are.
        parameters: the tree; effects that it switches on belong to the nominal model.
        view: (machine, nominal parameters) -> how recordings show it.
        catalogue: effects that may be missing (all that the machine can have).
        external: what acts on the mechanism from outside (`Machine.external`) is recorded too.
    """
    nominal = nominal_parameters(machine, parameters)

    def without(effect: str) -> System:
        simpler = parameters.changed({f"{machine.branch}.{effect}.enabled": False})
        return machine_system(machine, simpler, view, catalogue, external)

    seen = replace(view(machine, nominal), external=machine.external if external else "")
    effects = machine.catalogue if catalogue is None else catalogue
    return _Described(machine, nominal, seen).system(effects, without)


class _Described:
    """A machine with its nominal parameters and its view."""

    def __init__(self, machine: Machine, nominal: Parameters, view: View):
        self._machine, self._nominal, self._view = machine, nominal, view
        self._settings = dict(nominal.at(machine.branch).items())
        self._suspects = suspects(nominal, view.suspects)
        self.present = enabled(nominal.at(machine.branch))
        present = [machine.possible[name] for name in self.present if view.learns]
        # parameters of effects that the model has already are recalibrated; its dead times, s, are exact
        self._learned = [one for one in present if one.parameters and not one.shape and one.late is None]
        self._lateness = {e.name: e.late(self._settings[e.name]) for e in present if e.late is not None}
        self._calibrations = (*view.calibrations, *self._of_learned())
        sensors = [(one, self._seen(one).advance) for one in present if one.advance is not None]
        shown = [advance(self._settings[one.name]) for one, advance in sensors if advance is not None]
        self._aged = {channel: float(seconds) for each in shown for channel, seconds in each.items()}
        names = MOTION if view.neighbour else ()
        self._motion = tuple(f"{view.neighbour}_{name}" for name in names)  # states that are only recorded
        self._sensed = (view.external,) if view.external else ()  # inputs beside the voltages

    def system(self, catalogue: Mapping[str, Effect], without: Callable[[str], System]) -> System:
        """Return the system; `without` makes it without an effect that the model has already."""
        machine, view = self._machine, self._view
        known = {name: self._seen(self._placed(effect)) for name, effect in catalogue.items()}
        wrong = self._suspects if catalogue is machine.catalogue else {}
        return System(
            name=view.title,
            channels=view.channels,
            inputs=(*view.inputs, *self._sensed),
            input_units=dict.fromkeys(self._sensed, machine.coordinate.effort_unit),
            gradual=self._sensed,
            sensed=self._sensed,
            derived={"velocity": machine.coordinate.name}
            | dict.fromkeys(self._motion[1:2], *self._motion[:1]),
            derived_twice=dict.fromkeys(self._motion[2:], *self._motion[:1]),
            equations=self._equations({**machine.catalogue, **known}),
            calibrations=self._calibrations,
            catalogue={n: effect for n, effect in known.items() if n not in self.present} | wrong,
            entries=self._entries(),
            wrong=meant(view.suspects) if wrong else {},
            common=common(self._nominal, view.suspects) if wrong else {},
            shares=self._shares() if wrong else {},
            assemble=self._assemble,
            needs={
                **dict.fromkeys(("gas", "valve", "supply"), view.inputs),
                **dict.fromkeys(("torque", view.equation) if self._sensed else (), self._sensed),
            },
            equation_names={"torque": view.equation},
            branch=machine.branch,
            simpler={name: partial(without, name) for name in self.present},
            limits=view.limits,
            ambient=self._nominal.valve.ambient_pressure,
            input_period=machine.takes.get("scenario.control_period", "scenario.control_period"),
            late=self._nominal.valve.delay + sum(self._lateness.values()) if view.learns else 0.0,
            aged=self._aged,
            unusable=view.unusable,
            sources=view.sources,
            boxes=tuple(boxes(machine, self._nominal, view.channels)),
            also_recorded=tuple(Topics(machine).signals),
        )

    def _shares(self) -> dict[str, str]:
        """Return the calibrations that move exactly what a candidate takes to be wrong."""
        known = {one.name for one in self._view.calibrations}
        moved = {tuple(keys): name for name, keys in self._view.multiplied.items() if name in known}
        suspects = {name_of(key): tuple(of) or (key,) for key, of in self._view.suspects.items()}
        return {name: moved[keys] for name, keys in suspects.items() if keys in moved}

    def _entries(self) -> dict[str, tuple[Entry, ...]]:
        """Return how something unknown may enter: as effort, rate of a pressure, voltage, gain of a valve."""
        machine, first = self._machine, self._view.channels[0]
        c = machine.coordinate
        found: dict[str, tuple[Entry, ...]] = {}
        found[first.name] = (self._entry(c.effort_unit, c.effort, PUSH, 1.0, f"unknown_{c.effort}"),)
        actuators = {f"{name}_pressure": name for name in machine.names}
        for channel in self._view.channels:
            if name := actuators.get(channel.state or ""):
                found[channel.name] = (
                    self._entry(f"{channel.unit}/s", held=f"{name}_unknown_rate"),
                    self._entry(
                        "V", f"{name} voltage", f"{name}_closed_voltage", VOLTS, f"{name}_unknown_voltage"
                    ),
                    self._entry(
                        "-", f"{name} valve gain", f"{name}_valve_gain.gain", SHARE, f"{name}_unknown_gain"
                    ),
                )
        return found

    def _entry(
        self, unit: str, name: str = "", parameter: str = "", size: float = 1.0, held: str = ""
    ) -> Entry:
        free = held in self._machine.possible and held not in self.present
        return Entry(unit, name, parameter, size, held if free else "")

    def _of_learned(self) -> tuple[Calibration, ...]:
        row, sd = self._nominal.row("gap.learned.deviation"), self._nominal.gap.learned.deviation
        return tuple(
            Calibration(name, sd, row.unit, row.meaning, True)
            for effect in self._learned
            for name in _deviations(effect).values()
        )

    def _placed(self, effect: Effect) -> Effect:
        """Return an effect that is looked for at the machine's own places, and at small sizes too."""
        if self._view.usual:
            return effect
        size, *others = effect.parameters
        starts = effect.starts
        if effect.states and size.neutral is not None:  # those without states begin near zero in any case
            starts = (*starts, {size.name: size.neutral + SMALL * (size.typical - size.neutral)})
        middle = 0.5 * sum(self._machine.mechanism(self._nominal).limits)
        moved = (replace(q, typical=middle) if q.name == effect.middle else q for q in others)
        return replace(effect, starts=starts, parameters=(size, *moved))

    def _seen(self, effect: Effect) -> Effect:
        """Return an effect with channels in place of the signals that it lags behind or is drawn over."""
        names = {one.state: one.name for one in self._view.channels if one.state is not None}
        advance = effect.advance
        if all(state == name for state, name in names.items()):
            return effect
        if advance is None:
            return replace(effect, coordinate=names.get(effect.coordinate, effect.coordinate))
        return replace(effect, advance=lambda p: {names[k]: v for k, v in advance(p).items()})

    def _equations(self, catalogue: Mapping[str, Effect]) -> tuple[Equation, ...]:
        def held(channel: str) -> dict[str, float]:
            states = [one for effect in catalogue.values() for one in effect.held.items()]
            return {state: gains[channel] for state, gains in states if channel in gains}

        view, coordinate = self._view, self._machine.coordinate.name
        pressure_gain = self._nominal.gap.replay.pressure_gain
        states = tuple(f"{name}_pressure" for name in self._machine.names)
        pressures = {one.name: one.state for one in view.channels if one.state in states}
        first = view.channels[0].name
        motion = {first: {coordinate: view.gains[0], "velocity": view.gains[1], **held(first)}}
        gas = {name: {state: pressure_gain, **held(name)} for name, state in pressures.items()}
        others = tuple(one.name for one in view.channels if one.name not in {*pressures, *self._motion})
        return (
            Equation(view.equation, (coordinate, "velocity"), others, motion, view.stiff),
            Equation("gas", states, tuple(pressures), gas, view.stiff),
        )

    def _assemble(self, effects: tuple[str, ...]) -> Assembled:
        names = [one.name for one in self._calibrations]
        catalogue = {**self._machine.catalogue, **self._suspects}
        own = [f"{name}.{q.name}" for name in effects for q in catalogue[name].parameters]
        theta = ca.SX.sym("theta", len(names) + len(own))
        symbols = dict(zip([*names, *own], ca.vertsplit(theta), strict=True))
        beside = ca.SX.sym("beside", len(self._motion))
        assembly = assemble(self._hardware(effects, symbols, beside))
        u, time = ca.SX.sym("u", len(self._view.inputs) + len(self._sensed)), ca.SX.sym("time")
        volts = [u[i] + symbols[f"{name}_closed_voltage"] for i, name in enumerate(self._machine.names)]
        beyond = {"time": time, **dict(zip(self._sensed, ca.vertsplit(u)[len(volts) :], strict=True))}
        inputs = ca.vertcat(*volts, *(beyond.get(name, 0) for name in self._machine.inputs[len(volts) :]))
        measured = self._measured(assembly.signals, symbols)
        measured |= {name: beside[i] for i, name in enumerate(self._motion[:1])}
        rates, *shown = ca.substitute([assembly.rates, *measured.values()], [assembly.u], [inputs])
        by_channel = dict(zip(measured, shown, strict=True))
        states, x = (*assembly.states, *self._motion), ca.vertcat(assembly.x, beside)
        whole = ca.vertcat(rates, beside[1:], ca.SX.zeros(min(1, len(self._motion))))
        return Assembled(states, x, u, time, theta, (*names, *own), whole, by_channel)

    def _measured(self, s: Signals, symbols: Symbols) -> dict[str, Expression]:
        """Return what the sensors show: channel -> expression."""
        beside = self._view.beside(s, symbols)
        shown = {self._machine.coordinate.name: s.measured}
        shown |= {f"{name}_pressure": one.measured for name, one in s.actuators.items()}

        def of(channel: Channel) -> Expression:
            if channel.state is None:
                return beside[channel.name]
            offset = f"{channel.state}_offset"
            known = offset in symbols and offset not in self._view.added
            return shown[channel.state] + symbols[offset] if known else shown[channel.state]

        return {one.name: of(one) for one in self._view.channels if one.name not in self._motion}

    def _hardware(self, effects: tuple[str, ...], symbols: Symbols, beside: Expression) -> Hardware:
        machine, values = self._machine, self._nominal.flat()
        wrong = corrected(values, symbols, self._view.suspects)
        values |= wrong
        deviating = wrong | {
            key: values[key] * (1 + symbols[name])
            for name, keys in self._view.multiplied.items()
            if name in symbols
            for key in keys
        }
        deviating |= {key: values[key] + symbols[name] for name, key in self._view.added.items()}
        true = self._nominal.substituted(deviating)
        own = self._view.mechanism
        alone = own(true, symbols) if own else machine.mechanism(true)
        mechanism = machine.beside(true, beside) if self._motion else alone
        return Hardware(
            machine,
            mechanism,
            true.valve,
            {one.name: self._actuator(one.name, one.built(true), symbols) for one in machine.actuators},
            Section(machine.branch, self._effect_settings(effects, symbols)),
        )

    def _actuator(self, name: str, nominal: Actuator, symbols: Symbols) -> Actuator:
        """Return an actuator whose force, and damping if that is its own, are off.

        At a leap of the force a fit would see no way down.
        """
        damping = nominal.damping
        if name in self._view.damped:
            damping *= 1 + symbols.get(f"{name}_damping", 0.0)
        return replace(nominal.scaled(1 + symbols[f"{name}_force"]), damping=damping, onset=ONSET)

    def _effect_settings(self, effects: tuple[str, ...], symbols: Symbols) -> dict[str, Any]:
        """Return the settings of all effects: present ones, recalibrated, and those that are tried."""
        branch, settings = self._machine.branch, dict(self._settings)
        settings |= {name: Section(f"{branch}.{name}", {"enabled": False}) for name in self._lateness}
        for effect in self._learned:
            known = dict(self._settings[effect.name].items())
            moved = {q: known[q] * (1 + symbols[name]) for q, name in _deviations(effect).items()}
            settings[effect.name] = Section(f"{branch}.{effect.name}", {"enabled": True, **moved})
        for name in (one for one in effects if one not in self._suspects):
            tried = {q.name: symbols[f"{name}.{q.name}"] for q in self._machine.catalogue[name].parameters}
            settings[name] = Section(f"{branch}.{name}", {"enabled": True, **tried})
        return settings


def _deviations(effect: Effect) -> dict[str, str]:
    """Return, for each parameter of a learned effect, the name of its relative deviation."""
    return {q.name: f"{effect.name}_{q.name}" for q in effect.parameters}
