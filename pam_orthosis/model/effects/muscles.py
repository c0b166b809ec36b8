# SPDX-License-Identifier: Apache-2.0
"""Forces and volumes of muscles beside those of their maps."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Expression

WHOLE_PRESSURE = 6.0e5  # Pa gauge, the upper end of the maps; `asymmetry`, `damping`, `half_width` hold there
SLOW = 4.0  # times the time constant of the branch that relaxes first, that of the other one
FAR = 5.0  # times the contraction after which the first fibres slide, the others do
WHOLE_STROKE = 0.25  # relative contraction, the upper end of the maps
FORCE_TERMS = tuple((i, j) for i in range(4) for j in range(4) if i + j <= 3)
VOLUME_TERMS = {
    "c0": "constant part",
    "cx": "part that grows with the contraction",
    "cxx": "part that bends with the contraction",
    "cxxx": "part that bends twice",
    "cp": "part that grows with the pressure",
}


def _creep(s: ActuatorSignals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """Two Maxwell branches beside a muscle; the states are the stretches of their springs, m."""
    fast, slow = states
    rates = (s.rate - fast / p.time_constant, s.rate - slow / (SLOW * p.time_constant))
    return Contribution({"force": -p.stiffness * (fast + p.slow * (slow - fast))}, rates)


def _damping_by_direction(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """D + a while a muscle shortens, D - a while it lengthens: the difference is -a |rate|."""
    rounding = 1e-3  # m/s, over which |rate| is rounded at standstill
    speed = ca.sqrt(s.rate**2 + rounding**2) - rounding
    return Contribution({"force": -p.asymmetry * s.gauge / WHOLE_PRESSURE * speed})


def chebyshev(order: int, x: Expression) -> Expression:
    """Return the Chebyshev polynomial T_n(x) by its recurrence."""
    before, now = 1.0, x
    for _ in range(order):
        before, now = now, 2 * x * now - before
    return before


def normalised(value: Expression, whole: Expression) -> Expression:
    """Return a value of 0 .. whole scaled to -1 .. 1, clamped."""
    return ca.fmin(ca.fmax(2 * value / whole - 1, -1), 1)


def _force_map_misfit(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """Sum of products of Chebyshev polynomials up to the third order."""
    coefficients = dict(p.items())
    x = normalised(s.contraction, WHOLE_STROKE * s.length)
    y = normalised(s.gauge, WHOLE_PRESSURE)
    terms = [coefficients[f"c{i}{j}"] * chebyshev(i, x) * chebyshev(j, y) for i, j in FORCE_TERMS]
    return Contribution({"force": sum(terms)})


def _force_coefficient(i: int, j: int) -> Quantity:
    size = 6.0 / (1 + (i + j) / 3)
    meaning = f"coefficient of T{i}(contraction) T{j}(pressure), both scaled to -1 .. 1"
    return Quantity(f"c{i}{j}", size, "N", -80.0, 80.0, meaning, 0.0, prior=size)


def _muscle_hysteresis(s: ActuatorSignals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """A muscle that shortens pulls less: two Bouc-Wen operators (A = beta + gamma = 1, n = 2)."""
    near, far = states
    smooth = ca.sqrt(s.rate**2 + 1e-12)
    winding = [s.rate - 0.5 * (smooth * z * ca.fabs(z) + s.rate * z**2) for z in states]
    level = p.offset_share + (1 - p.offset_share) * s.gauge / WHOLE_PRESSURE
    slid = near + p.far_share * (far - near)
    rates = (winding[0] / p.sliding_distance, winding[1] / (FAR * p.sliding_distance))
    return Contribution({"force": -p.half_width * level * slid}, rates)


def _damping_by_pressure(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """A muscle loses force while it shortens, gains it while it is stretched."""
    share = p.damping / WHOLE_PRESSURE
    return Contribution({"force": -share * s.gauge * s.rate})


def _volume_misfit(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """The volume and its two derivatives stay consistent."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")  # contraction and pressure, -1 to 1
    by_x, by_y = 2 / (WHOLE_STROKE * s.length), 2 / WHOLE_PRESSURE
    here = [by_x * s.contraction - 1, by_y * s.gauge - 1]
    error = p.c0 + p.cx * x + p.cxx * (2 * x**2 - 1) + p.cxxx * (4 * x**3 - 3 * x) + p.cp * y
    all_of_it = [error, by_x * ca.gradient(error, x), by_y * ca.gradient(error, y)]
    error, by_contraction, by_pressure = ca.substitute(all_of_it, [x, y], here)
    return Contribution(
        {
            "volume": error * s.volume,
            "volume_by_contraction": error * s.volume_by_contraction + by_contraction * s.volume,
            "volume_by_pressure": error * s.volume_by_pressure + by_pressure * s.volume,
        }
    )


EFFECTS = [
    Effect(
        name="creep",
        of="muscles",
        stage="force",
        parameters=(
            Quantity("stiffness", 600.0, "N/m", 0.0, 20000.0, "stiffness of what relaxes", 0.0),
            Quantity("time_constant", 1.0, "s", 0.05, 30.0, "time constant of the relaxation"),
            Quantity("slow", 0.0, "-", 0.0, 1.0, f"share that relaxes {SLOW:g} times as slowly", fitted=False,
                     meaningful=(0.0, 0.95)),  # above it, the time constant is another one
        ),
        expression=_creep,
        physics="Rubber and fibres of a muscle flow: at once it answers a change of length as a stiffer "
        "spring, then the additional force relaxes. At a constant load it creeps on by several per cent.",
        source="measured creep of about a quarter of the fast part in 4 s, time constants 0.5 to 1 s "
        "(facts of published DMSP-10 data); data sheet: relaxation up to 5 %",
        minimum_effect=50.0,
        starts=({"time_constant": 0.25}, {"time_constant": 5.0}),
        coordinate="{actuator}_contraction",
        confounded_with=("muscle_hysteresis", "parallel_elasticity"),
        separated_by=("diagnostic-hold", "diagnostic-cocontraction"),
        states=("{actuator}_creep", "{actuator}_slow_creep"),
        scales=(0.01, 0.01),
    ),
    Effect(
        name="direction_dependent_damping",
        of="muscles",
        stage="force",
        parameters=(
            Quantity("asymmetry", 150.0, "N s/m", -3000.0, 3000.0,
                     "half the difference of the dampings of shortening and lengthening at 6 bar gauge", 0.0),
        ),
        expression=_damping_by_direction,
        physics="A muscle is damped more while it contracts than while it relaxes, the more the higher its "
        "pressure. At equal pressures the two muscles of a joint hide it: one shortens while the other "
        "lengthens at the same rate.",
        source="Reynolds et al. 2003 (relaxation damped less than contraction); magnitude: assumption",
        minimum_effect=30.0,
        coordinate="{actuator}_rate",
        starts=({"asymmetry": -150.0},),
        confounded_with=("pressure_dependent_damping",),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
    ),
    Effect(
        name="force_map_misfit",
        of="muscles",
        separate=True,
        stage="force",
        parameters=tuple(_force_coefficient(i, j) for i, j in FORCE_TERMS),
        expression=_force_map_misfit,
        physics="The polynomial of Eq. (14) is not a muscle's true map: fibres, end caps and rubber leave a "
        "smooth error of some newtons over contraction and pressure. No term exceeds its coefficient, so "
        "the correction is bounded.",
        source="paper: errors up to 30 N; polynomial against the measured map: RMS 3.5 to 15 N",
        minimum_effect=2.0,
        coordinate="{actuator}_contraction",
        confounded_with=("parallel_elasticity", "{actuator}_force_scale"),
        separated_by=("diagnostic-cocontraction", "diagnostic-triangle"),
        shape=True,
    ),
    Effect(
        name="{actuator}_force_scale",
        of="actuator",
        stage="force",
        parameters=(Quantity("scale", 0.9, "-", 0.3, 2.0, "true force / force of the map", 1.0),),
        expression=lambda s, p, _states: Contribution({"force": (p.scale - 1) * s.force}),
        physics="The {actuator}'s specimen, its wear, or a broken fibre makes the whole static force map "
        "larger or smaller by a factor.",
        source="manufacturer's tolerance 10 %; published maps of the same type differ by 6 to 9 %",
        minimum_effect=0.02,
        starts=({"scale": 1.1},),
        coordinate="{actuator}_pressure",
        confounded_with=("{actuator}_pressure_gain", "constant_torque"),
        within="force_map_misfit",
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="muscle_hysteresis",
        of="muscles",
        stage="force",
        parameters=(
            Quantity("half_width", 12.0, "N", 0.0, 200.0, "half width of the force loop at 6 bar gauge", 0.0),
            Quantity("offset_share", 0.4, "-", 0.0, 1.0, "share of the half width left without pressure",
                     fitted=False, meaningful=(0.0, 1.0)),
            Quantity("sliding_distance", 1.0e-3, "m", 5.0e-5, 0.02, "contraction until the fibres slide",
                     meaningful=(1.0e-4, 0.01)),  # shorter, the load rubs; wider, it is an elasticity
            Quantity("far_share", 0.0, "-", 0.0, 0.8, f"share that slides after {FAR:g} times of it",
                     fitted=False, meaningful=(0.0, 0.8)),
        ),
        expression=_muscle_hysteresis,
        physics="The fibres of the braid rub on each other and on the rubber. They stick over a short "
        "distance, some over a longer one, then slide; the friction grows with the pressure on them.",
        source="Bouc-Wen operator; half width 8 to 15 N for a 20 mm muscle, extrapolated from a measured "
        "loop of a DMSP-10-250",
        minimum_effect=2.0,
        starts=({"sliding_distance": 3.0e-4}, {"sliding_distance": 4.0e-3}),
        coordinate="{actuator}_rate",
        confounded_with=("joint_friction", "creep"),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
        states=("{actuator}_hysteresis", "{actuator}_hysteresis_far"),
        scales=(1.0, 1.0),
    ),
    Effect(
        name="pressure_dependent_damping",
        of="muscles",
        stage="force",
        parameters=(
            Quantity("damping", 120.0, "N s/m", 0.0, 3000.0, "damping factor added at 6 bar gauge", 0.0),
        ),
        expression=_damping_by_pressure,
        physics="The pressure presses the fibres of the braid on each other and on the rubber: a muscle at a "
        "higher pressure resists a motion more. With a constant sum of pressures the sum of both dampings "
        "stays constant, so a gait hardly shows it; free decays at two mean pressures do.",
        source="Reynolds et al. 2003 (damping of contraction rises with pressure); magnitude: assumption",
        minimum_effect=20.0,
        coordinate="{actuator}_rate",
        confounded_with=("muscle_hysteresis", "viscous_friction"),
        separated_by=("diagnostic-decay",),
    ),
    Effect(
        name="volume_misfit",
        of="muscles",
        separate=True,
        stage="gas",
        parameters=tuple(
            Quantity(k, 0.015, "-", -0.3, 0.3, f"relative error of the volume, {text}", 0.0, prior=0.015)
            for k, text in VOLUME_TERMS.items()
        ),
        expression=_volume_misfit,
        physics="The cylinder with two frustums of Eq. (15) is not a muscle's true shape; its volume is off "
        "by a per cent or two, differently for a short and a long, a soft and a hard muscle.",
        source="conical ends: 5 to 12 % of the braid's volume at high contraction, known to a fifth of that",
        minimum_effect=0.005,
        coordinate="{actuator}_contraction",
        confounded_with=("{actuator}_dead_volume", "polytropic_exponent"),
        separated_by=("diagnostic-locked",),
        shape=True,
    ),
]  # fmt: skip
