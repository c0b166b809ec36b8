# SPDX-License-Identifier: Apache-2.0
"""Tables in HTML, of pages and of notebooks, and as text."""

from collections.abc import Iterable, Sequence
from html import escape


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """Return a table of texts; `caption` is read out before it."""
    lines = ["".join(f'<th scope="col">{escape(name)}</th>' for name in head)] if head else []
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{title}" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


class Shown:
    """An object that is a table: HTML in a notebook, text where it is printed."""

    def _shown(self) -> tuple[Sequence[str], Sequence[Sequence[str]], str]:
        """Return head, rows and what they are, in words."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return table(*self._shown())

    def __repr__(self) -> str:
        head, rows, words = self._shown()
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in (head, *rows))
        return "\n".join((words, *lines))
