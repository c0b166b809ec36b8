# SPDX-License-Identifier: Apache-2.0
"""A page for each effect of the catalogue, from the effect objects, and their index."""

import inspect
import textwrap

from generators.markdown import bounds, table, value
from pam_orthosis.model.effects.base import STAGES, Effect
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import Row, load, scenario_names

FOLDER = "reference/effects"


def pages() -> dict[str, str]:
    """Return the pages."""
    made = {f"{FOLDER}/{effect.name}.md": _page(effect) for effect in KNEE.catalogue.values()}
    return {f"{FOLDER}/index.md": _index(), **made}


def _index() -> str:
    shipped = load().flat()
    rows = [
        (
            f"[{e.title}]({e.name}.md)", e.stage, e.equation,
            "yes" if shipped[f"plant.effects.{e.name}.enabled"] else "",
            ", ".join(f"{q.name} [{q.unit}]" for q in e.fitted),
        )
        for stage in STAGES for e in KNEE.catalogue.values() if e.stage == stage
    ]  # fmt: skip
    words = (
        "# Catalogue of effects\n\n"
        f"{len(rows)} physical effects. The emulated hardware, the controllers' model and the gap workflow"
        " use the same objects. One parameter switches an effect on."
        " [Extend the package](../../howto/extend.md) shows how to add one.\n\n"
    )
    head = ("effect", "stage", "equation", "on in the emulated hardware", "what the gap workflow estimates")
    return words + table(head, rows)


def _page(e: Effect) -> str:
    parts = [
        f"# {e.title.capitalize()}\n\n{e.physics}\n\nSource: {e.source}.\n\n",
        f"It enters the stage `{e.stage}` of the model. The residual of the {e.equation} equation shows it.",
        f" Its states are {_names(e.states)}.\n\n" if e.states else " It has no state.\n\n",
        "## Equation\n\nThe function returns what the effect adds to the signals `s`, and the rates of its"
        " states; `p` holds its parameters.\n\n",
        f"```python\n{_source(e)}\n```\n\n",
        "## Parameters\n\n", _parameters(e), "\n", _switch(e), "\n", _confusion(e),
    ]  # fmt: skip
    return "".join(parts).rstrip() + "\n"


def _source(e: Effect) -> str:
    return textwrap.dedent(inspect.getsource(e.expression)).strip()


def _parameters(e: Effect) -> str:
    rows = [
        (
            f"`{q.name}`", q.meaning, value(q.typical), q.unit,
            bounds(Row("", q.typical, q.unit, q.minimum, q.maximum, "", "")),
            "-" if q.neutral is None else value(q.neutral), "yes" if q.fitted else "no",
        )
        for q in e.parameters
    ]  # fmt: skip
    head = (
        "parameter",
        "meaning",
        "typical",
        "unit",
        "range",
        "the effect vanishes at",
        "estimated by `gap`",
    )
    return table(head, rows)


def _switch(e: Effect) -> str:
    return (
        "## Switch it on\n\n"
        f"- in the emulated hardware: `--param plant.effects.{e.name}.enabled=true`\n"
        f"- in the controllers' model: `--param effects.{e.name}.enabled=true`\n"
        f"- hidden in recordings for the gap workflow: `pam-orthosis gap-hide --effect {e.name} --out DIR`\n"
    )


def _confusion(e: Effect) -> str:
    if not e.confounded_with:
        return ""
    alike = ", ".join(f"[{name.replace('_', ' ')}]({name}.md)" for name in e.confounded_with)
    words = f"## Confounded effects\n\nIn ordinary motion it is nearly indistinguishable from {alike}."
    if e.separated_by:
        meaning = scenario_names()
        ways = "".join(
            f"\n- `{name}`: {meaning[name]}" if name in meaning else f"\n- {name.replace('_', ' ')}"
            for name in e.separated_by
        )
        words += f" These experiments separate them:\n{ways}"
    return words


def _names(names) -> str:
    return ", ".join(f"`{name}`" for name in names)
