# SPDX-License-Identifier: Apache-2.0
"""Parts of self-contained HTML pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

STYLE = """
body {font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em}
table {border-collapse: collapse} td, th {padding: .2em .8em; border-bottom: 1px solid #ccc; text-align: left}
img {max-width: 100%} pre {white-space: pre-wrap}
"""


def document(title: str, body: str) -> str:
    """Return a page that needs nothing but itself."""
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<link rel="icon" href="data:,"><style>{STYLE}</style>{body}</html>\n'
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of texts."""
    lines = ["".join(f"<th>{escape(name)}</th>" for name in head)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"
