# SPDX-License-Identifier: Apache-2.0
"""The hidden plant's physics: a second realisation, independent of `model`, compiled by numba.

It shares no code and, for the hidden effects, no form with the model that is fitted to its
recordings: Maxwell-slip elements for the muscles' hysteresis, LuGre for joint friction, a hard play,
ring buffers for dead times, an orifice as leak, two creep constants, edges of the dead band that
differ, a hose with a turbulent share. Integration: Heun, one step `STEP`; operators with memory are
updated exactly between steps. SI units; pressures absolute unless named gauge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pam_orthosis.testing.mechanics import (
    clip,
    compiled,
    dragged,
    load_terms,
    pulled,
    sprocket,
    stops,
    strokes,
)

if TYPE_CHECKING:
    from pam_orthosis.testing.quantities import Apparatus, Hidden, Maps

STEP = 5.0e-5  # s
RING = 2048  # steps that the ring buffers remember: 0.1 s
ELEMENTS = 5  # Maxwell-slip elements a muscle
GAS_CONSTANT, DENSITY, REFERENCE_TEMPERATURE = 287.06, 1.185, 293.15
LAMINAR_RATIO = 0.995
HYSTERESIS_FLOOR = 0.4  # share of the hysteresis left without pressure
MAP_STROKE, MAP_PRESSURE = 0.125, 6.0e5  # whole contraction m and gauge pressure Pa of the maps

Q, W, PE, PF, SE1, SE2, SF1, SF2, SAG, CE1, CE2, CF1, CF2, BRISTLE = range(14)  # continuous states
STATES = 14
RING_UE, RING_UF, RING_REFLEX, RING_Q, RING_PE, RING_PF = range(6)  # ring buffers


@compiled
def polynomial(c: np.ndarray, x: float) -> tuple[float, float]:
    """Return the value and the derivative of sum c_i x^i."""
    value, slope = 0.0, 0.0
    for k in range(len(c) - 1, -1, -1):
        slope = slope * x + value
        value = value * x + c[k]
    return value, slope


@compiled
def orifice(
    conductance: float, upstream: float, downstream: float, critical: float, temperature: float
) -> float:
    """Return the mass flow by ISO 6358, laminar near equal pressures; negative if it reverses."""
    high, low = max(upstream, downstream), min(upstream, downstream)
    r = low / high
    depth = max(min(r, LAMINAR_RATIO) - critical, 0.0) / (1 - critical)
    psi = np.sqrt(1 - depth * depth) * min((1 - r) / (1 - LAMINAR_RATIO), 1.0)
    flow: float = conductance * DENSITY * high * np.sqrt(REFERENCE_TEMPERATURE / temperature) * psi
    return flow if upstream >= downstream else -flow


@compiled
def spool_opening(deviation: float, gain: float, wave: np.ndarray, a: Apparatus, h: Hidden) -> float:
    """Return the relative opening for a voltage above the closed one: edges, gain, curve."""
    fill, vent = 1.25 * h.dead_band, 0.75 * h.dead_band
    free = deviation - clip(deviation, -vent, fill)
    opening = clip(free / a.half_span, -1.0, 1.0)
    error = wave[0] * np.sin(wave[1] * opening + wave[2]) if wave[0] != 0.0 else 0.0
    return gain * opening * (1 + error)


@compiled
def valve_flow(opening: float, pressure: float, supply: float, a: Apparatus, h: Hidden) -> float:
    """Return the mass flow into the muscle through valve and fitting in series."""
    c = abs(opening) * a.conductance
    if c == 0.0:
        return 0.0
    c = c * a.hose_conductance / np.cbrt(c * c * c + a.hose_conductance**3)
    if opening > 0:
        return orifice(c, supply, pressure, a.critical_ratio, a.temperature)
    return -orifice(c, pressure, a.ambient, a.critical_ratio, a.temperature)


@compiled
def hose_drop(flow: float, h: Hidden) -> float:
    """Return the pressure drop of the hose: mostly laminar, with a share that grows with the flow."""
    return h.hose * flow * (0.85 + 0.15 * abs(flow) / 3e-3)


@compiled
def hose_flow(opening: float, pressure: float, supply: float, a: Apparatus, h: Hidden) -> float:
    """Return the flow that valve and hose agree upon, by regula falsi (Illinois form)."""
    flow = valve_flow(opening, pressure, supply, a, h)
    if h.hose == 0.0 or flow == 0.0:
        return flow
    low, high, wrong_low = 0.0, flow, flow
    wrong_high = valve_flow(opening, pressure + hose_drop(flow, h), supply, a, h) - flow
    for _ in range(12):
        if abs(wrong_high) < 1e-12 or wrong_high == wrong_low:
            break
        middle = high - wrong_high * (high - low) / (wrong_high - wrong_low)
        wrong = valve_flow(opening, pressure + hose_drop(middle, h), supply, a, h) - middle
        if wrong * wrong_high < 0:
            low, wrong_low = high, wrong_high
        else:
            wrong_low *= 0.5
        high, wrong_high = middle, wrong
    return high


@compiled
def slip_force(x: float, anchors: np.ndarray) -> float:
    """Return the Maxwell-slip force of unit half width at a contraction."""
    force = 0.0
    for i in range(ELEMENTS):
        force += clip((x - anchors[i]) / slip_distance(i), -1.0, 1.0)
    return force / ELEMENTS


@compiled
def slip_distance(i: int) -> float:
    """Return the contraction over which an element sticks, m: 0.2 to 2.2 mm."""
    return 2.0e-4 * 1.82**i


@compiled
def map_error(waves: np.ndarray, x: float, gauge: float) -> float:
    """Return the misfit of a force map, N."""
    error = 0.0
    for k in range(waves.shape[0]):
        if waves[k, 0] == 0.0:
            continue
        phase = waves[k, 1] * x / MAP_STROKE + waves[k, 2] * gauge / MAP_PRESSURE + waves[k, 3]
        error += waves[k, 0] * np.sin(phase)
    return error


@compiled
def muscle(
    x: float, rate: float, gauge: float, creep: float, scale: float, anchors: np.ndarray,
    waves: np.ndarray, a: Apparatus, h: Hidden, maps: Maps,
) -> float:  # fmt: skip
    """Return the tension of a muscle or the push of a chamber, N."""
    s = clip(x * a.stroke_scale, a.box_start, a.box_contraction)
    force = polynomial(maps.a, s)[0] * clip(gauge, 0.0, a.box_gauge) - polynomial(maps.b, s)[0]
    force = scale * force + map_error(waves, x, gauge) - h.creep * creep
    share = gauge / 6.0e5
    if h.hysteresis != 0.0:
        level = HYSTERESIS_FLOOR + (1 - HYSTERESIS_FLOOR) * share
        force -= h.hysteresis * level * slip_force(x, anchors)
    force -= share * (h.pressure_damping * rate + h.direction_damping * abs(rate))
    if a.pushes > 0.0:
        return force - a.damping * rate
    return max(force - a.damping * rate, 0.0) if force > 0 else 0.0


@compiled
def volume(
    x: float, gauge: float, dead: float, wave: np.ndarray, a: Apparatus, maps: Maps
) -> tuple[float, float, float]:
    """Return the volume with its derivatives by pressure and contraction."""
    s = clip(x * a.stroke_scale, a.box_start, a.box_contraction)
    v, v_slope = polynomial(maps.v, s)
    w, w_slope = polynomial(maps.w, clip(gauge, 0.0, a.box_gauge))
    error, error_slope = 1.0, 0.0
    if wave[0] != 0.0:
        phase = wave[1] * x / MAP_STROKE + wave[2]
        error, error_slope = 1 + wave[0] * np.sin(phase), wave[0] * np.cos(phase) * wave[1] / MAP_STROKE
    plain = v * w / a.stroke_scale
    by_x = v_slope * w * error + plain * error_slope
    return plain * error + a.hose_volume + dead, v * w_slope / a.stroke_scale * error, by_x


@compiled
def friction(bristle: float, w: float, h: Hidden) -> tuple[float, float]:
    """Return LuGre's torque and the rate of its bristle (deflection in units of the Coulomb torque)."""
    if h.coulomb == 0.0:
        return 0.0, 0.0
    stiffness = 500.0  # 1/rad: 2 mrad of pre-sliding
    level = 1 + 0.2 * np.exp(-((w / 0.1) ** 2))
    rate = stiffness * (w - abs(w) * bristle / level)
    return h.coulomb * (bristle + 0.0005 * rate), rate


@compiled
def torque_from_outside(
    t: float, w: float, q: float, reflex: float, a: Apparatus, h: Hidden, maps: Maps
) -> float:
    """Return what acts on the load beside actuators and friction, N m or N."""
    torque = h.constant_torque - h.viscosity * w - h.reflex_gain * reflex
    if h.periodic_torque != 0.0:
        phase = 2 * np.pi * h.periodic_frequency * t + h.periodic_phase
        torque += h.periodic_torque * (np.sin(phase) + 0.05 * np.sin(3 * phase))
    bend = q - a.middle
    torque -= h.elasticity * bend * (0.97 + 0.3 * (bend / a.unit) * (bend / a.unit))
    if h.cogging != 0.0:
        torque += h.cogging * np.sin(14 * q / a.unit)
    torque += h.detent * np.exp(-((bend / (0.12 * a.unit)) ** 2)) - h.drag * w * abs(w)
    place = min(t * 1e3, len(maps.torque) - 1.001)
    k = int(place)
    whole: float = torque + maps.torque[k] + (place - k) * (maps.torque[k + 1] - maps.torque[k])
    return whole


@compiled
def rates(
    x: np.ndarray, out: np.ndarray, t: float, ue: float, uf: float, reflex: float, wheel: float,
    anchors: np.ndarray, a: Apparatus, b: Apparatus, h: Hidden, maps: Maps, mb: Maps,
) -> tuple[float, float]:  # fmt: skip
    """Write the rates of all continuous states; return the flows behind the hoses, kg/s."""
    q, w, pe, pf = x[Q], x[W], x[PE], x[PF]
    turned, turning = sprocket(q, w, wheel, h)
    xe, xf, re, rf = strokes(turned, turning, a, maps)
    ge, gf = pe - a.ambient, pf - a.ambient
    if h.valve_lag > 0.0:
        out[SE1], out[SE2] = (ue - x[SE1]) / h.valve_lag, (x[SE1] - x[SE2]) / h.valve_lag
        out[SF1], out[SF2] = (uf - x[SF1]) / h.valve_lag, (x[SF1] - x[SF2]) / h.valve_lag
        ue, uf = x[SE2], x[SF2]
    gain_e = h.valve_gain_e * (1 + h.gain_drift * t / 30.0)
    oe = spool_opening(ue, gain_e, maps.valve_waves[0], a, h)
    of = spool_opening(uf, h.valve_gain_f, mb.valve_waves[1], b, h)
    oe, of = oe + h.cross_talk * of, of + h.cross_talk * oe
    supply = a.supply - x[SAG]
    fe, ff = hose_flow(oe, pe, supply, a, h), hose_flow(of, pf, supply, b, h)
    drawn = h.sag * (max(fe, 0.0) + max(ff, 0.0)) - x[SAG]
    out[SAG] = drawn / (0.04 if drawn > 0 else 0.06)
    across = h.cross_leak * (pe - pf)
    out[PE] = pressure_rate(
        pe, fe - across, xe, re, h.leak_e, h.dead_volume_e, maps.volume_waves[0], t, a, h, maps
    )
    out[PF] = pressure_rate(
        pf, ff + across, xf, rf, h.leak_f, h.dead_volume_f, mb.volume_waves[1], t, b, h, mb
    )
    out[CE1], out[CE2] = re - x[CE1] / 0.6, re - x[CE2] / 1.8
    out[CF1], out[CF2] = rf - x[CF1] / 0.6, rf - x[CF2] / 1.8
    ce, cf = 0.6 * x[CE1] + 0.4 * x[CE2], 0.6 * x[CF1] + 0.4 * x[CF2]
    scale_e, scale_f = a.force * h.force_scale_e, b.force * h.force_scale_f
    te = muscle(xe, re, ge, ce, scale_e, anchors[0], maps.force_waves[0], a, h, maps)
    tf = muscle(xf, rf, gf, cf, scale_f, anchors[1], mb.force_waves[1], b, h, mb)
    rubbing, out[BRISTLE] = friction(x[BRISTLE], w / a.unit, h)
    torque = pulled(te, tf, turned, a, maps) - rubbing - a.load_damping * w + stops(q, w, a)
    torque += torque_from_outside(t, w, q, reflex, a, h, maps) + h.jet * oe
    inertia, slope, gravity = load_terms(q, a, h, maps.load)
    out[Q] = w
    out[W] = (torque - gravity - 0.5 * slope * w * w) / inertia
    if a.locked > 0:
        out[Q], out[W] = 0.0, 0.0
    return fe, ff


@compiled
def pressure_rate(
    p: float, flow: float, x: float, rate: float, leak: float, dead: float, wave: np.ndarray,
    t: float, a: Apparatus, h: Hidden, maps: Maps,
) -> float:  # fmt: skip
    """Return dp/dt of a muscle with an orifice as leak and gas that warms with two time constants."""
    if leak > 0.0:
        flow -= leak_flow(leak, p, a)
    temperature = a.temperature
    if h.warming != 0.0:
        warm = 1 - 0.5 * np.exp(-2.0 * t / h.warming_time) - 0.5 * np.exp(-t / (1.5 * h.warming_time))
        temperature += h.warming * warm
    n = a.exponent + h.exponent_shift
    v, by_p, by_x = volume(x, p - a.ambient, dead, wave, a, maps)
    return n / (v + n * by_p * p) * (GAS_CONSTANT * temperature * flow - by_x * rate * p)


@compiled
def leak_flow(leak: float, p: float, a: Apparatus) -> float:
    """Return the flow of an orifice that passes `leak` (kg/(s Pa)) times the gauge pressure at 3 bar."""
    there = a.ambient + 3.0e5
    reference = orifice(1.0, there, a.ambient, 0.3, a.temperature)
    return leak * 3.0e5 / reference * orifice(1.0, p, a.ambient, 0.3, a.temperature)


@compiled
def late(ring: np.ndarray, row: int, index: int, delay: float) -> float:
    """Return the value that a ring buffer held a delay ago (linear between steps)."""
    steps = delay / STEP
    k = int(steps)
    f = steps - k
    now, before = ring[row, (index - k) % RING], ring[row, (index - k - 1) % RING]
    value: float = now + f * (before - now)
    return value


@compiled
def advance(
    x: np.ndarray, wheel: np.ndarray, spools: np.ndarray, anchors: np.ndarray, ring: np.ndarray,
    index: int, steps: int, ue: float, uf: float,
    a: Apparatus, b: Apparatus, h: Hidden, maps: Maps, mb: Maps,
) -> int:  # fmt: skip
    """Advance all states by `steps` with the valve voltages (above closed, V) held; return the index."""
    k1, k2, middle = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    for _ in range(steps):
        ring[RING_UE, index % RING], ring[RING_UF, index % RING] = ue, uf
        ring[RING_REFLEX, index % RING] = x[W] - clip(x[W], -h.reflex_threshold, h.reflex_threshold)
        t = index * STEP
        ve = spools[0] = dragged(spools[0], late(ring, RING_UE, index, h.valve_delay), h.spool_play)
        vf = spools[1] = dragged(spools[1], late(ring, RING_UF, index, h.valve_delay), h.spool_play)
        reflex = late(ring, RING_REFLEX, index, h.reflex_delay)
        fe, ff = rates(x, k1, t, ve, vf, reflex, wheel[0], anchors, a, b, h, maps, mb)
        ring[RING_Q, index % RING] = x[Q]
        ring[RING_PE, index % RING] = x[PE] + hose_drop(fe, h)
        ring[RING_PF, index % RING] = x[PF] + hose_drop(ff, h)
        for i in range(STATES):
            middle[i] = x[i] + STEP * k1[i]
        rates(middle, k2, t + STEP, ve, vf, reflex, wheel[0], anchors, a, b, h, maps, mb)
        for i in range(STATES):
            x[i] += 0.5 * STEP * (k1[i] + k2[i])
        wheel[0] = dragged(wheel[0], x[Q], h.play)
        xe, xf, _, _ = strokes(wheel[0], 0.0, a, maps)
        for i in range(ELEMENTS):
            d = slip_distance(i)
            anchors[0, i] = clip(anchors[0, i], xe - d, xe + d)
            anchors[1, i] = clip(anchors[1, i], xf - d, xf + d)
        index += 1
    return index


@compiled
def sense(
    x: np.ndarray, wheel: np.ndarray, anchors: np.ndarray, ring: np.ndarray, index: int,
    ue: float, uf: float, a: Apparatus, b: Apparatus, h: Hidden, maps: Maps, mb: Maps,
) -> tuple[float, float, float]:  # fmt: skip
    """Return noise-free sensor values at the present instant: coordinate, both pressures."""
    scratch = np.zeros(STATES)
    fe, ff = rates(x, scratch, index * STEP, ue, uf, 0.0, wheel[0], anchors, a, b, h, maps, mb)
    ring[RING_Q, index % RING] = x[Q]
    ring[RING_PE, index % RING] = x[PE] + hose_drop(fe, h)
    ring[RING_PF, index % RING] = x[PF] + hose_drop(ff, h)
    angle = h.angle_gain * late(ring, RING_Q, index, h.angle_delay) + h.angle_offset
    pe = late(ring, RING_PE, index, h.pressure_delay_e) - a.ambient
    pf = late(ring, RING_PF, index, h.pressure_delay_f) - a.ambient
    pe = a.ambient + h.pressure_gain_e * pe + h.pressure_offset_e
    return angle, pe, a.ambient + h.pressure_gain_f * pf + h.pressure_offset_f
