# SPDX-License-Identifier: Apache-2.0
"""The live view beside a run (`run --watch`)."""

from __future__ import annotations

import os
import subprocess
import sys
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pam_orthosis.errors import RunFailed

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
LEAVE_SECONDS = 5.0


@contextmanager
def watched(command: Sequence[str], environment: Mapping[str, str], work: Path) -> Iterator[None]:
    """Show a run for as long as it lasts: print the page's address, open it where there is a display.

    Args:
        command: of the live view.
        environment: of its process.
        work: folder for its log.

    Raises:
        RunFailed: the view does not start.
    """
    log = work / "live_view.log"
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
    with (
        open(log, "wb") as errors,
        subprocess.Popen(command, env=dict(environment), stderr=errors, text=True, **streams) as viewer,
    ):
        try:
            url = viewer.stdout.readline().strip() if viewer.stdout else ""
            if not url:
                words = log.read_text(errors="replace").strip().splitlines() or ["it printed nothing"]
                raise RunFailed(f"the live view did not start: {words[-1]}")
            print(f"live view: {url}", file=sys.stderr)
            if any(os.environ.get(name) for name in DISPLAYS):
                webbrowser.open(url)
            yield
        finally:
            viewer.terminate()
            try:
                viewer.wait(LEAVE_SECONDS)
            except subprocess.TimeoutExpired:
                viewer.kill()
