# SPDX-License-Identifier: Apache-2.0
"""A node with the states of ROS (unconfigured, inactive, active), which needs no manager to come up."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes.parameters import Setting, declare_settings

AUTOSTART = {"autostart": Setting(True, "becomes inactive at once, and active when its peers are there")}
DONE, REFUSED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ManagedNode(LifecycleNode):
    """A node that is made by `configure`, works between `activate` and `deactivate`, and ends with `close`.

    With the parameter `autostart` it configures itself when it is made, or raises what that raises; otherwise
    `ros2 lifecycle set` or another manager does. Errors of a transition refuse it, and are reported in one
    line. `place` are arguments of ROS that are its own, such as its namespace, where nodes share a process.

    Attributes:
        configured, active: its state.
        over: it was shut down, and its process is to end.
        alone: in its process.
        worn: its process is to begin anew, which leaves nothing behind. The executor of events would die of
            events for publishers and subscriptions that are destroyed while it spins.
        alarm: is called when something has happened that its process has to look at.
    """

    def __init__(self, name: str, place: Sequence[str] = ()):
        super().__init__(name, cli_args=["--ros-args", *place] if place else None)
        self.configured = self.active = self.over = self.worn = False
        self.alone = True
        self.alarm: Callable[[], None] = lambda: None
        self.autostart: bool = declare_settings(self, AUTOSTART)["autostart"]
        self._refusal: Exception | None = None
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = partial(self._change, service.callback)
        if self.autostart:
            try:
                self._raised(self.trigger_configure)
            except BaseException:
                self.destroy_node()  # left to the collector, it would go at a moment that nobody chose
                raise

    def configure(self) -> None:
        """Make what the node needs; raise OrthosisError if it cannot."""

    def activate(self) -> None:
        """Begin to work; raise OrthosisError to refuse."""

    def deactivate(self) -> None:
        """Stop working: publish no more."""

    def close(self) -> None:
        """Release what the node holds; called once, however it ended."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the node."""
        if self._refused(self.configure):
            self.worn = True
            self.alarm()
            return REFUSED
        self.configured = True
        return DONE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let it work."""
        return REFUSED if self._refused(self.activate) else DONE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let it work no more."""
        self.deactivate()
        self.active = False
        return DONE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Have the process begin anew; REFUSED where it has other nodes too."""
        self.worn = self.alone
        self.alarm()
        return DONE if self.alone else REFUSED

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Have the process end as on a signal."""
        self.over = True
        self.alarm()
        return DONE

    def come_up(self) -> None:
        """Become active, unless somebody else manages the node."""
        if self.autostart:
            self._raised(self.trigger_activate)

    def destroy_node(self) -> None:
        """Leave the graph, which in rclpy of Jazzy a state machine would stay in."""
        super().destroy_node()  # type: ignore[no-untyped-call]  # rclpy gives it no types
        self._state_machine.destroy_when_not_in_use()

    def _refused(self, act: Callable[[], None]) -> bool:
        """Return whether a part of a transition fails; rclpy would swallow why."""
        try:
            act()
        except Exception as error:
            self._refusal = error
        return self._refusal is not None

    def _raised(self, trigger: Callable[[], Any]) -> None:
        """Go through a transition; raise what it was refused with."""
        self._refusal = None
        trigger()
        if self._refusal:
            raise self._refusal

    def _change(self, change: Callable[..., ChangeState.Response], *call: Any) -> ChangeState.Response:
        """Answer who changes the state: rclpy would die of a transition that there is not."""
        self._refusal = None
        try:
            answer = change(*call)
        except RuntimeError as error:
            self._refusal, answer = error, ChangeState.Response(success=False)
        if self._refusal:
            known = isinstance(self._refusal, OrthosisError)
            self.get_logger().error(str(self._refusal) if known else repr(self._refusal))
        return answer
