# SPDX-License-Identifier: Apache-2.0
"""Tables in HTML, of pages and of notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """Return a table of texts; `caption` is read out before it."""
    lines = ["".join(f'<th scope="col">{escape(name)}</th>' for name in head)] if head else []
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{title}" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"
