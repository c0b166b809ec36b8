# SPDX-License-Identifier: Apache-2.0
"""A cylinder on a carriage whose guide rubs: a device by the textbook, without the model of `pam_orthosis`.

python hidden.py TABLE.csv SEED    writes a recording
python hidden.py                   is the hardware driver of `pam-orthosis run --realtime --no-plant`
"""

import contextlib
import sys

import numpy as np

NAMES = ("push", "pull")
MASS, SEALS, START, STROKE = 8.1, 40.0, 0.15, 0.3  # kg, N s/m of both seals together, m, m
AREA, DEAD = np.array([8.0e-4, 6.9e-4]), 5.8e-5  # m^2, and m^3 of a chamber and its hose without stroke
FRICTION, BREAKAWAY, STRIBECK, BRISTLES = 12.0, 14.0, 0.01, 2.0e5  # N, N, m/s, N/m
SUPPLY, AMBIENT, RT, EXPONENT = 6.9e5, 1.013e5, 287.06 * 293.15, 1.25
ORIFICE, HOSE, CRITICAL = 5.8e-9, 4.2e-8, 0.3  # m^3/(s Pa), m^3/(s Pa), - (ISO 6358)
PERIOD, STEP = 0.01, 2.0e-4  # s


class Cylinder:
    """Position x, velocity v, bristles' deflection z (LuGre's friction), pressures p of push and pull."""

    def __init__(self, seed=0):
        self.random = np.random.default_rng(seed)
        self.x, self.v, self.z = START, 0.0, 0.0
        self.p = AMBIENT + 2.5e5 * np.array([AREA[1] / AREA[0], 1.0])
        self.volts = np.full(2, 5.0)

    def read(self):
        """Return position, m, and both pressures, Pa."""
        x = self.x + 1e-5 * self.random.standard_normal()
        return x, *(self.p + 500.0 * self.random.standard_normal(2))

    def live(self):
        """Let a period pass under the present voltages (Euler's method)."""
        for _ in range(round(PERIOD / STEP)):
            volume = DEAD + AREA * [self.x, STROKE - self.x]
            gained = RT * self._flow() - self.p * AREA * [self.v, -self.v]
            self.p = self.p + STEP * EXPONENT / volume * gained
            force = AREA[0] * (self.p[0] - AMBIENT) - AREA[1] * (self.p[1] - AMBIENT)
            self.v += STEP / MASS * (force - SEALS * self.v - self._friction())
            self.x += STEP * self.v
            if not 0.0 <= self.x <= STROKE:  # at an end stop
                self.x, self.v = float(np.clip(self.x, 0.0, STROKE)), 0.0

    def _friction(self):
        level = FRICTION + (BREAKAWAY - FRICTION) * np.exp(-((self.v / STRIBECK) ** 2))
        steady = level / BRISTLES * np.sign(self.v)
        self.z = steady + (self.z - steady) * np.exp(-STEP * BRISTLES / level * abs(self.v))
        return BRISTLES * self.z

    def _flow(self):
        """Return the mass flow into each chamber through a valve and a hose in series, kg/s."""
        spool = np.clip((self.volts - 5.0) / 5.0, -1.0, 1.0)
        c = np.abs(spool) * ORIFICE
        c = c * HOSE / np.cbrt(c**3 + HOSE**3)
        up, down = np.where(spool > 0, SUPPLY, self.p), np.where(spool > 0, self.p, AMBIENT)
        ratio = np.minimum(down / up, 1.0)
        subsonic = np.sqrt(1 - (np.maximum(ratio - CRITICAL, 0) / (1 - CRITICAL)) ** 2)
        return np.sign(spool) * c * 1.185 * up * subsonic


def record(path, seed, seconds=20.0):
    """Write a recording of ever faster motion at two mean pressures, under a controller of its own."""
    device, rows, before = Cylinder(seed), [], START
    for time in np.arange(0.0, seconds, PERIOD):
        x, *pressures = device.read()
        wanted = START + 0.06 * np.sin((0.3 + 0.25 * seed + 0.1 * time) * time) + 0.02 * np.sin(3.7 * time)
        drive = 40.0 * (wanted - x) - 2.0 * (x - before) / PERIOD
        level = 1.0e-5 * (3.0e5 + 1.5e5 * (time > seconds / 2) - np.mean(pressures))
        device.volts, before = np.clip(5.0 + level + [drive, -drive], 0.0, 10.0), x
        rows.append((time, x, *pressures, *device.volts))
        device.live()
    columns = ["time", "position", *(f"{n}_pressure" for n in NAMES), *(f"{n}_voltage" for n in NAMES)]
    np.savetxt(path, rows, "%.8g", delimiter=",", header=",".join(columns), comments="")


def drive():
    """Be the driver of a run: a sample each period, the newest voltages, none for 20 periods vents."""
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data as sensor
    from rclpy.signals import SignalHandlerOptions
    from rclpy.time import Time
    from sensor_msgs.msg import FluidPressure, JointState

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # its own may end the context in mid-spin
    node, device, silent = Node("hidden_cylinder"), Cylinder(), np.full(2, -np.inf)
    joint = node.create_publisher(JointState, "joint_states", sensor)
    gauges = [node.create_publisher(FluidPressure, f"{name}/pressure", sensor) for name in NAMES]
    period_ns, first_ns, passed = round(PERIOD * 1e9), node.get_clock().now().nanoseconds, 0

    def take(side, message):
        if message.position and np.isfinite(message.position[0]):
            device.volts[side], silent[side] = 5.0 + 5.0 * np.clip(message.position[0], -1.0, 1.0), 0
            silent[:] = np.maximum(silent, 0)  # the other's are awaited from now on

    def tick():
        nonlocal passed
        due = (node.get_clock().now().nanoseconds - first_ns + period_ns // 2) // period_ns
        for _ in range(due - passed):
            silent[:] += 1
            if silent.max() > 20:
                device.volts[:] = 0.0
            device.live()
        if due > passed:
            passed = due
            publish(Time(nanoseconds=first_ns + due * period_ns).to_msg())

    def publish(stamp):
        x, *pressures = device.read()
        sample = JointState(name=["cylinder"], position=[x])
        messages = [sample, *(FluidPressure(fluid_pressure=p) for p in pressures)]
        for publisher, message in zip([joint, *gauges], messages, strict=True):
            message.header.stamp = stamp
            publisher.publish(message)

    for side, name in enumerate(NAMES):
        node.create_subscription(JointState, f"{name}/valve_command", lambda m, s=side: take(s, m), 10)
    node.create_timer(PERIOD, tick)
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(node)


if __name__ == "__main__":
    drive() if len(sys.argv) == 1 else record(sys.argv[1], int(sys.argv[2]))
