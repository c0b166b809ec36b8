# SPDX-License-Identifier: Apache-2.0
"""Equations as a script in Python has them: a line of arithmetic for each operation, called with numbers."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca

OPERATIONS = {
    "ADD": "{} + {}", "SUB": "{} - {}", "MUL": "{} * {}", "DIV": "{} / {}", "NEG": "-{}",
    "SQ": "{0} * {0}", "TWICE": "2.0 * {}", "INV": "1.0 / {}", "SQRT": "sqrt({})", "FABS": "abs({})",
    "FMAX": "max({}, {})", "FMIN": "min({}, {})", "SIGN": "({0} > 0) - ({0} < 0)",
    "LT": "{} < {}", "LE": "{} <= {}", "EQ": "{} == {}", "NE": "{} != {}",
    "NOT": "not {}", "AND": "{} and {}", "OR": "{} or {}", "IF_ELSE_ZERO": "{1} if {0} else 0.0",
    "POW": "{} ** {}", "CONSTPOW": "{} ** {}", "EXP": "exp({})", "LOG": "log({})", "SIN": "sin({})",
    "COS": "cos({})", "TAN": "tan({})", "TANH": "tanh({})", "ASINH": "asinh({})",
    "ATAN": "atan({})", "ATAN2": "atan2({}, {})",
}  # fmt: skip
_TEXTS = {getattr(ca, f"OP_{name}"): text for name, text in OPERATIONS.items()}


def scripted(function: ca.Function) -> Callable[..., list[float]]:
    """Return a function of vectors, and with one vector as result, as Python code."""
    scope = {name: getattr(math, name) for name in dir(math) if not name.startswith("_")}
    exec("\n    ".join(_lines(function)), scope)
    return scope["evaluated"]


def _lines(function: ca.Function) -> list[str]:
    given = ", ".join(f"i{k}" for k in range(function.n_in()))
    lines = [f"def evaluated({given}):", f"out = [0.0] * {function.nnz_out(0)}"]
    for k in range(function.n_instructions()):
        lines.append(_line(function, k))
    return [*lines, "return out"]


def _line(function: ca.Function, k: int) -> str:
    operation, to, of = (
        function.instruction_id(k),
        function.instruction_output(k),
        function.instruction_input(k),
    )
    if operation == ca.OP_CONST:
        return f"w{to[0]} = {float(function.instruction_constant(k))!r}"
    if operation == ca.OP_INPUT:
        return f"w{to[0]} = i{of[0]}[{of[1]}]"
    if operation == ca.OP_OUTPUT:
        return f"out[{to[1]}] = w{of[0]}"
    return f"w{to[0]} = {_TEXTS[operation].format(*(f'w{each}' for each in of))}"
