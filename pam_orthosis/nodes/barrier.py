# SPDX-License-Identifier: Apache-2.0
"""The start of a run: a node waits until all its peers are there and were started alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.node import Node

from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes.agreement import Agreement

if TYPE_CHECKING:
    from pam_orthosis.nodes.topic_node import TopicNode

PEER_POLL_SECONDS = 0.02
PEER_SECONDS, PEER_REPORT_SECONDS = 5.0, 30.0  # until it is said who is waited for, and said again


class Notice:
    """Tells the log of a node for whom it waits: once, and now and then again.

    Args:
        node: whose log.
        patience: before the first `remind` says anything, s.
    """

    def __init__(self, node: Node, patience: float = 0.0):
        self._node, self._said, self._due = node, "", time.monotonic() + patience

    def say(self, text: str) -> None:
        """Say it, if that is news or due."""
        if text != self._said:
            self._due = 0.0
        self.remind(text)

    def remind(self, text: str) -> None:
        """Say it if that is due, news or not."""
        if time.monotonic() > self._due:
            self._said, self._due = text, time.monotonic() + PEER_REPORT_SECONDS
            self._node.get_logger().info(text)


class Barrier:
    """Looks whether all peers are there, says for whom it waits, and lets the node start once.

    It calls `begin` when all are there, `fail` with the error if two nodes were started differently.
    """

    def __init__(
        self,
        node: TopicNode,
        begin: Callable[[], None],
        fail: Callable[[OrthosisError], None],
    ):
        self._begin, self._fail = begin, fail
        self._peers: dict[str, Callable[[], bool]] = {}
        self._agreements: list[Agreement] = []
        self._notice = Notice(node, PEER_SECONDS)
        self._timer = node.wall_timer(PEER_POLL_SECONDS, self._look)

    def await_peer(self, peer: str, there: Callable[[], bool]) -> None:
        """Do not start before this one is there; `peer` names it in the log."""
        self._peers[peer] = there

    def await_agreement(self, agreement: Agreement) -> None:
        """Do not start before all nodes of a leg are known to have been started alike."""
        self._agreements.append(agreement)

    def anew(self) -> bool:
        """Whether a node has been started again since this one hears it."""
        return any(agreement.again for agreement in self._agreements)

    def missing(self) -> list[str]:
        """Return who or what must be there before the start and is not."""
        absent = [role for agreement in self._agreements for role in agreement.absent]
        return absent or [peer for peer, there in self._peers.items() if not there()]

    def _look(self) -> None:
        broken = next((each for each in self._agreements if each.text), None)
        if broken:
            if broken.known_to_all():
                self._fail(OrthosisError(broken.text))
        elif missing := self.missing():
            self._notice.remind(f"waiting for {', '.join(missing)}")
        else:
            self._timer.cancel()
            self._begin()
