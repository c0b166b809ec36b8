# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's side: one hinge with friction and stops, two muscles on tendons with activation dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import rollout

MODEL = """
<mujoco>
  <option timestep="{step}" integrator="{integrator}"/>
  <worldbody>
    <body pos="0 0 1">
      <joint name="knee" axis="0 1 0" range="-5 100" limited="true" damping="0.2" frictionloss="0.8"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.42" size="0.03" mass="3"/>
      <geom type="sphere" pos="0 0 -0.42" size="0.05" mass="1.2"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="extensor"><joint joint="knee" coef="0.03"/></fixed>
    <fixed name="flexor"><joint joint="knee" coef="-0.03"/></fixed>
  </tendon>
  <actuator>
    <muscle tendon="extensor" force="1000" lengthrange="-0.05 0.05"/>
    <muscle tendon="flexor" force="1000" lengthrange="-0.05 0.05"/>
  </actuator>
</mujoco>
"""


class Hinge:
    """The model, stepped for some seconds by calls of whole recordings.

    Args:
        integrator: MuJoCo's name of it.
    """

    def __init__(self, integrator: str, step: float, seconds: float):
        self._model = mujoco.MjModel.from_xml_string(MODEL.format(step=step, integrator=integrator))
        self._steps = round(seconds / step)

    def __call__(self) -> float:
        """Step one model; return its angle in the end, rad."""
        data = mujoco.MjData(self._model)
        data.ctrl[:] = 0.3, 0.1
        mujoco.mj_step(self._model, data, nstep=self._steps)
        return float(data.qpos[0])

    def many(self, count: int, threads: int) -> np.ndarray:
        """Step models with random controls, by threads; return their states, (count, steps, states)."""
        begin = np.zeros((count, mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
        controls = np.random.default_rng(1).uniform(0, 1, (count, 1, self._model.nu))
        controls = np.repeat(controls, self._steps, axis=1)
        workers = [mujoco.MjData(self._model) for _ in range(threads)]
        return rollout.rollout(self._model, workers, begin, controls)[0]
