# SPDX-License-Identifier: Apache-2.0
"""How the recorder's process is scheduled."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")

TOLD = """
import os
from pam_orthosis.nodes import bag_recorder, process
process.run = lambda make_nodes: print(os.sched_getscheduler(0))
os.sched_setscheduler(0, {before}, os.sched_param(0))
bag_recorder.main()
"""


@pytest.mark.parametrize(
    ("before", "after"), [(os.SCHED_OTHER, os.SCHED_BATCH), (os.SCHED_IDLE, os.SCHED_IDLE)]
)
def test_the_recorder_interrupts_nobody_unless_somebody_has_chosen(before, after):
    code = TOLD.format(before=before)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == after
