# SPDX-License-Identifier: Apache-2.0
"""What viewers need of a leg, in the bag: description, TF, joints, markers beside the measurements."""

from __future__ import annotations

from collections.abc import Mapping

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.scene.messages import LATCHED, TYPES
from pam_orthosis.scene.sampled import SampledScene


class RecordedScene:
    """Writes what viewers need of a leg into its bag; `names` are the absolute ones of the topics."""

    def __init__(self, scene: SampledScene, writer: BagWriter, names: Mapping[str, str]):
        self._scene = scene
        scene.prepare()
        self._writer = writer
        self._names = names
        for topic, name in names.items():
            writer.add_topic(name, TYPES[topic], topic in LATCHED)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Take a measurement; write what is due."""
        for said in self._scene.add(topic, stamp_ns, data):
            self._writer.write(self._names[said.topic], stamp_ns, said.data)
