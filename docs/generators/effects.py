# SPDX-License-Identifier: Apache-2.0
"""A page for each effect of the catalogue, from the effect objects, and their index."""

import inspect
import textwrap

from generators.markdown import NOTE, bounds, table, value
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import STAGES, Effect
from pam_orthosis.model.parameters import Row, load, scenario_names


def pages() -> dict[str, str]:
    """Return the pages."""
    made = {f"effects/{effect.name}.md": _page(effect) for effect in CATALOGUE.values()}
    return {"effects/index.md": _index(), **made}


def _index() -> str:
    shipped = load().flat()
    rows = [
        (
            f"[{e.title}]({e.name}.md)", e.stage, e.equation,
            "yes" if shipped[f"plant.effects.{e.name}.enabled"] else "",
            ", ".join(f"{q.name} [{q.unit}]" for q in e.fitted),
        )
        for stage in STAGES for e in CATALOGUE.values() if e.stage == stage
    ]  # fmt: skip
    words = (
        "# Catalogue of effects\n\n"
        f"{len(rows)} effects that a model can have or lack. The emulated hardware, the controllers' model"
        " and the gap workflow use the same objects; one is switched on by one parameter. How to add one:"
        " [Extending](../extending.md).\n\n"
    )
    head = ("effect", "stage", "equation", "on in the emulated hardware", "what the gap workflow estimates")
    return NOTE + words + table(head, rows)


def _page(e: Effect) -> str:
    parts = [
        f"# {e.title.capitalize()}\n\n{e.physics}\n\nSource: {e.source}.\n\n",
        f"It enters the stage `{e.stage}` of the model and shows in the {e.equation} equation.",
        f" States of its own: {_names(e.states)}.\n\n" if e.states else " It has no state of its own.\n\n",
        "## Equation\n\nWhat it adds to the signals `s`, and its states' rates; `p` are its parameters.\n\n",
        f"```python\n{_source(e)}\n```\n\n",
        "## Parameters\n\n", _parameters(e), "\n", _switch(e), "\n", _confusion(e),
    ]  # fmt: skip
    return NOTE + "".join(parts).rstrip() + "\n"


def _source(e: Effect) -> str:
    return textwrap.dedent(inspect.getsource(e.expression)).strip()


def _parameters(e: Effect) -> str:
    rows = [
        (
            f"`{q.name}`", value(q.typical), q.unit,
            bounds(Row("", q.typical, q.unit, q.minimum, q.maximum, "", "")), q.meaning,
            "-" if q.neutral is None else value(q.neutral), "yes" if q.fitted else "no",
        )
        for q in e.parameters
    ]  # fmt: skip
    head = (
        "parameter",
        "typical",
        "unit",
        "range",
        "meaning",
        "the effect vanishes at",
        "estimated by `gap`",
    )
    return table(head, rows)


def _switch(e: Effect) -> str:
    return (
        f"On in the emulated hardware: `--param plant.effects.{e.name}.enabled=true`; in the controllers'"
        f" model: `--param effects.{e.name}.enabled=true`. As a blind case of the gap workflow:"
        f" `pam-orthosis gap-hide --effect {e.name}`.\n"
    )


def _confusion(e: Effect) -> str:
    if not e.confounded_with:
        return ""
    alike = ", ".join(f"[{name.replace('_', ' ')}]({name}.md)" for name in e.confounded_with)
    words = f"## What looks alike\n\nOrdinary motion hardly tells it from: {alike}."
    if e.separated_by:
        told = scenario_names()
        ways = "".join(
            f"\n- `{name}`: {told[name]}" if name in told else f"\n- {name.replace('_', ' ')}"
            for name in e.separated_by
        )
        words += f" These tell them apart:\n{ways}"
    return words


def _names(names) -> str:
    return ", ".join(f"`{name}`" for name in names)
