# SPDX-License-Identifier: Apache-2.0
"""A walk with 75 kg at too low a supply, with and without a plan; draws plan.png here.

python benchmarks/plan.py
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning.plan import make_plan

PICTURE = Path("plan.png")
SUPPLY, MARGIN = 5.2e5, 1.5e4  # Pa
KNOWN = ("joint_friction", "viscous_friction", "muscle_hysteresis", "valve_lag", "valve_dead_band")
SECONDS, SHOWN = 9.0, (4.0, 6.0)
BAR = 1e-5


def parameters():
    """Return the shipped hardware at a low supply that the nominal model knows, as most of its effects."""
    hardware = load(scenario_overrides("person") | {"plant.deviation.supply_pressure": SUPPLY / 7e5})
    known = {"valve.supply_pressure": SUPPLY, "control.position.maximum_pressure": SUPPLY - MARGIN}
    return with_nominal(hardware, known | {f"effects.{name}.enabled": True for name in KNOWN})


def main() -> None:
    """Run both, print their largest errors, draw them."""
    plain = parameters()
    plan = make_plan(plain)
    steps = round(SECONDS / plain.scenario.control_period)
    runs = {"without": plain, "with a plan": plain.changed(plan.overrides)}
    drawing = Figure(figsize=(9, 6), layout="constrained")
    knee, off, air = drawing.subplots(3, 1, sharex=True)
    for (name, each), colour in zip(runs.items(), ("tab:red", "tab:blue"), strict=True):
        run = ClosedLoop(each, 1).run(steps)
        error = np.degrees(run["reference_angle"] - run["angle"])
        print(f"{name}: {np.abs(error).max():.2f} deg")
        time = run["time"]
        knee.plot(time, np.degrees(run["angle"]), colour, lw=1, label=name)
        off.plot(time, error, colour, lw=1)
        air.plot(time, run["flexor_pressure"] * BAR, colour, lw=1, label=f"flexor, {name}")
        air.plot(time, run["extensor_pressure"] * BAR, colour, lw=1, ls="--", label=f"extensor, {name}")
    knee.plot(time, np.degrees(run["reference_angle"]), "k", lw=1, label="wanted")
    cycle = SHOWN[0] + np.arange(len(plan.wanted)) * plan.cycle_time / len(plan.wanted)
    off.plot(cycle, np.degrees(plan.wanted - plan.cycle.angle), "k:", lw=1, label="planned")
    air.axhline(SUPPLY * BAR, color="0.6", lw=1)
    for axes, label in ((knee, "knee / deg"), (off, "error / deg"), (air, "pressure / bar")):
        axes.set_ylabel(label)
        axes.legend(fontsize=8, ncols=2)
    air.set(xlabel="time / s", xlim=SHOWN)
    PICTURE.parent.mkdir(exist_ok=True)
    drawing.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
