# SPDX-License-Identifier: Apache-2.0
"""Pictures that a notebook shows by itself."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

DPI = 90


class Picture:
    """A drawn figure; a notebook shows it where it is the last value of a cell.

    Attributes:
        figure: of matplotlib, to change titles and limits.
    """

    def __init__(self, figure: Figure):
        self.figure = figure

    def save(self, path: str | Path) -> None:
        """Write the picture; the ending decides on the format (`.png`, `.svg`, `.pdf`)."""
        self.figure.savefig(path)

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=DPI)
        return stream.getvalue()
