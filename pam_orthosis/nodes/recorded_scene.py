# SPDX-License-Identifier: Apache-2.0
"""What viewers need of a leg, in the bag: description, TF, joints, markers beside the measurements."""

from collections.abc import Callable, Iterator, Mapping

from pam_orthosis.scene.messages import LATCHED, TYPES
from pam_orthosis.scene.sampled import SampledScene


class RecordedScene:
    """Makes what viewers need of a leg for its bag; `names` are the absolute ones of the topics.

    `add_topic` declares one: absolute name, type, whether it is latched.
    """

    def __init__(
        self, scene: SampledScene, add_topic: Callable[[str, str, bool], None], names: Mapping[str, str]
    ):
        self._scene = scene
        scene.prepare()
        self._names = names
        for topic, name in names.items():
            add_topic(name, TYPES[topic], topic in LATCHED)

    def of(self, topic: str, stamp_ns: int, data: bytes) -> Iterator[tuple[str, int, bytes]]:
        """Take a measurement; hand out what is due, as `BagWriter` takes it."""
        for said in self._scene.add(topic, stamp_ns, data):
            yield self._names[said.topic], stamp_ns, said.data
