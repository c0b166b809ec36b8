# SPDX-License-Identifier: Apache-2.0
"""Markdown from plain texts."""

from collections.abc import Iterable, Sequence

WIDE = "---\nhide: [toc]\n---\n\n"  # begins a page of wide tables


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(_cell(cell) for cell in line)} |" for line in lines) + "\n"


def first_sentence(docstring: str) -> str:
    """Return the first paragraph of a docstring as one line."""
    return " ".join(docstring.strip().split("\n\n")[0].split())


def parameter_rows(rows: Iterable) -> str:
    """Return a table of `model.parameters.Row`s."""
    head = ("parameter", "meaning", "shipped value", "unit", "range", "source")
    return table(head, [
        (f"`{r.key}`", r.meaning, value(r.value), r.unit, bounds(r), r.source) for r in rows
    ])  # fmt: skip


def value(one) -> str:
    """Return a parameter's value as short text."""
    if isinstance(one, list):
        return "[" + ", ".join(value(part) for part in one) + "]"
    if isinstance(one, float):
        return f"{one:.6g}"
    return str(one).lower() if isinstance(one, bool) else str(one)


def bounds(row) -> str:
    """Return a parameter's range or options."""
    if row.options:
        return ", ".join(row.options)
    if row.minimum is None and row.maximum is None:
        return "-"
    return " .. ".join("" if end is None else value(end) for end in (row.minimum, row.maximum))


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
