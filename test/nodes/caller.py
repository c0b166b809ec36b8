# SPDX-License-Identifier: Apache-2.0
"""A ROS node of somebody else that calls the services of a running graph."""

import rclpy
from live_runs import wait_for


class Caller:
    """A ROS node of somebody else: calls services and sets parameters of a running graph."""

    def __init__(self, domain):
        from rclpy.experimental import EventsExecutor
        from rosgraph_msgs.msg import Clock

        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("caller", context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._time_s = 0.0
        self.node.create_subscription(Clock, "/clock", self._on_clock, 10)

    def let_pass(self, seconds):
        """Wait until so much simulated time has passed."""
        begun = self._time_s
        wait_for(lambda: self._executor.spin_once(timeout_sec=0.1) or self._time_s > begun + seconds)

    def _on_clock(self, message):
        self._time_s = message.clock.sec + 1e-9 * message.clock.nanosec

    def call(self, name, kind, request):
        """Call a service; return its response."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=30)
        future = client.call_async(request)
        self._executor.spin_until_future_complete(future, timeout_sec=30)
        assert future.done()
        return future.result()

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(name, Trigger, Trigger.Request())

    def set(self, node, key, value):
        """Set a parameter of a node; return the result."""
        from rcl_interfaces.srv import SetParameters

        parameter = rclpy.parameter.Parameter(key, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return self.call(f"{node}/set_parameters", SetParameters, request).results[0]

    def close(self):
        self._executor.shutdown()  # before what it watches: the other way round it may never come back
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
