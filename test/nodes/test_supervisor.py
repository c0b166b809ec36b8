# SPDX-License-Identifier: Apache-2.0
"""The supervisor against processes that are no nodes."""

import os
import sys

import pytest

from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes.supervisor import supervise

STEPPING = """
import os, time
pipe = int(os.environ["PAM_ORTHOSIS_HEARTBEAT"])
while True:
    os.write(pipe, b"running 5000000\\n")
    time.sleep(0.05)
"""
MUTE = "import time; time.sleep(60)"
CRASHING = "import sys; sys.exit('pam-orthosis: error: no air')"


def run(tmp_path, **programs):
    commands = {name: [sys.executable, "-c", text] for name, text in programs.items()}
    supervise(commands, dict(os.environ), tmp_path, lambda _: None)


def test_a_process_that_never_beats_is_named_once_the_graph_steps(tmp_path):
    with pytest.raises(RunFailed, match="node mute did not answer"):
        run(tmp_path, stepping=STEPPING, mute=MUTE)


def test_a_crash_is_told_in_the_words_of_the_process(tmp_path):
    with pytest.raises(RunFailed, match="node crashing ended with 1: no air"):
        run(tmp_path, stepping=STEPPING, crashing=CRASHING)
