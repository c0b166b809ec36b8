# SPDX-License-Identifier: Apache-2.0
"""Print stiffness of the joint over p_im."""

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.stiffness import measured, modelled
from pam_orthosis.model.parameters import load, scenario_overrides

MEANS = (2.6e5, 3.1e5, 3.6e5, 4.1e5, 4.6e5)  # absolute Pa
WARM_UP = 4.0  # s
DRY = {f"plant.effects.{name}.enabled": False for name in ("joint_friction", "muscle_hysteresis")}


def on_plant(parameters) -> tuple[float, float]:
    """Return stiffness, N m/rad, and largest deflection, rad, measured with closed valves."""
    run = ClosedLoop(parameters, 1).run(round(parameters.scenario.duration / 0.005))
    angle = run["angle"][run["time"] > WARM_UP]
    frequency = parameters.plant.external_frequency
    found = measured(run["time"], run["angle"], run["true_torque"], frequency, WARM_UP)
    return found, 0.5 * (angle.max() - angle.min())


for mean in MEANS:
    p = load({
        **scenario_overrides("diagnostic-stiffness"), "control.position.mean_pressure": mean,
        "scenario.control_period": 0.005,
    })  # fmt: skip
    model = modelled(p, p.scenario.start_angle, mean)
    stiffness, deflection = on_plant(p)
    dry, _ = on_plant(p.changed(DRY))
    print(f"| {mean * 1e-5:.1f} bar | {model.held:.1f} | {model.closed:.1f} | {stiffness:.1f} | {dry:.1f}"
          f" | {57.3 * deflection:.1f} deg |", flush=True)  # fmt: skip
