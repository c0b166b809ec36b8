# SPDX-License-Identifier: Apache-2.0
"""C source that evaluates a CasADi function for several sets of numbers at once.

Every number of the function becomes a `lane`: a vector of one value a set, which the compiler maps onto the
processor's vector registers, however wide these are. For one set, whose lanes are single numbers, calls of
the same mathematical function that do not wait for each other fill the registers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from pam_orthosis.model.compiled import best_library, processor

# tried one after the other: what compilers, processors and mathematics libraries know differs
OPTIONS = (
    ("-march=native", "-mprefer-vector-width=512", "-fopenmp-simd", "-DVECTOR_MATHEMATICS"),
    ("-march=native", "-fopenmp-simd"),
    (),
)
# last digits may differ from one processor to the next, not from one set of numbers to its neighbours;
# an unknown function of the mathematics library is found when it is linked, not when it is called
FLAGS = (
    "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared",
    "-Wl,-z,defs", "-Wno-psabi",
)  # fmt: skip
HEADER = """/* {processor} */
#include <math.h>
typedef double lane __attribute__((vector_size({bytes}), aligned({bytes})));
typedef double loose __attribute__((vector_size({bytes}), aligned(8)));
static inline lane all(double value) {{ return value - (lane){{}}; }}
"""
HEADER_OF_ONE = """/* {processor} */
#include <math.h>
typedef double lane;
typedef double loose;
typedef double pack __attribute__((vector_size({pack}), aligned({pack})));
static inline lane all(double value) {{ return value; }}
"""
ELEMENTWISE = """
static {attribute} {type} {type}_{name}({given}) {{
  {type} result;
#pragma omp simd
  for (int i = 0; i < {lanes}; i++) result{at} = {value};
  return result;
}}
"""
PACK = 8  # calls that are made at once for a single set
# of most of its functions the mathematics library has versions for whole vectors
DECLARED = """
#ifdef VECTOR_MATHEMATICS
#pragma omp declare simd notinbranch
#endif
extern double {name}({types});
"""
UNARY = ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh",
         "asinh", "acosh", "atanh", "cbrt", "sqrt", "floor", "ceil")  # fmt: skip
BINARY = ("pow", "atan2", "fmod")
PROCESSORS_OWN = ("sqrt", "floor", "ceil", "fmod")  # not in the mathematics library's vectors
# what compilers turn into instructions of their own when it is said so
CHOICES = {
    "larger": "a > b ? a : b", "smaller": "a < b ? a : b", "absolute": "a < 0 ? -a : a",
    "sign": "(a > 0) - (a < 0)", "less": "a < b ? 1.0 : 0.0", "at_most": "a <= b ? 1.0 : 0.0",
    "equal": "a == b ? 1.0 : 0.0", "unequal": "a != b ? 1.0 : 0.0", "none": "a == 0 ? 1.0 : 0.0",
    "both": "a != 0 && b != 0 ? 1.0 : 0.0", "either": "a != 0 || b != 0 ? 1.0 : 0.0",
    "where": "a != 0 ? b : 0.0", "below_zero": "a < 0 ? b : c",
}  # fmt: skip
EXPRESSIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_FABS: "lane_absolute({0})", ca.OP_SIGN: "lane_sign({0})", ca.OP_NOT: "lane_none({0})",
    ca.OP_FMAX: "lane_larger({0}, {1})", ca.OP_FMIN: "lane_smaller({0}, {1})",
    ca.OP_LT: "lane_less({0}, {1})", ca.OP_LE: "lane_at_most({0}, {1})",
    ca.OP_EQ: "lane_equal({0}, {1})", ca.OP_NE: "lane_unequal({0}, {1})",
    ca.OP_AND: "lane_both({0}, {1})", ca.OP_OR: "lane_either({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "lane_where({0}, {1})", ca.OP_CONSTPOW: "lane_pow({0}, {1})",
    **{getattr(ca, f"OP_{name.upper()}"): f"lane_{name}({{0}})" for name in UNARY if name != "cbrt"},
    **{getattr(ca, f"OP_{name.upper()}"): f"lane_{name}({{0}}, {{1}})" for name in BINARY},
}  # fmt: skip


def header(lanes: int) -> str:
    """Return the types and functions that the other sources need, for this processor."""
    functions = {name: f"{name}(a)" for name in UNARY} | {name: f"{name}(a, b)" for name in BINARY}
    declared = [
        DECLARED.format(name=name, types="double, double" if name in BINARY else "double")
        for name in functions
        if name not in PROCESSORS_OWN
    ]
    defined = [_elementwise(name, value, lanes) for name, value in (functions | CHOICES).items()]
    if lanes == 1:
        whole = {name: value for name, value in functions.items() if name not in PROCESSORS_OWN}
        defined += [_elementwise(name, value, PACK, "pack") for name, value in whole.items()]
    types = HEADER_OF_ONE if lanes == 1 else HEADER
    sizes = {"bytes": 8 * lanes, "pack": 8 * PACK}
    return types.format(processor=processor(), **sizes) + "".join(declared + defined)


@dataclass(frozen=True)
class Statement:
    """One assignment of the C function.

    Attributes:
        target: name of the variable, empty for an output.
        text: what is assigned; for an output the whole assignment.
        given: variables that must be there before.
        call, arguments: the mathematical function, if it is one, and what it is called with.
    """

    target: str
    text: str
    given: tuple[str, ...]
    call: str = ""
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"  lane {self.target} = {self.text};" if self.target else f"  {self.text};"


def source(function: ca.Function, lanes: int) -> str:
    """Return a C function of lanes for an SX function: pointers to its inputs, then to its outputs, dense."""
    inputs = [f"const lane* restrict a{i}" for i in range(function.n_in())]
    outputs = [f"lane* restrict r{i}" for i in range(function.n_out())]
    head = f"static void {function.name()}({', '.join(inputs + outputs)}) {{"
    statements = _statements(function)
    body = _packed(statements) if lanes == 1 else [str(one) for one in statements]
    return "\n".join([head, *body, "}", ""])


def library(name: str, code: str) -> Path | None:
    """Return the library of a source with lanes, built for this processor; None without a compiler."""
    return best_library(name, code, FLAGS, OPTIONS)


def _statements(function: ca.Function) -> list[Statement]:
    """Return a function's instructions, each with a variable of its own."""
    names: dict[int, str] = {}  # place in the work vector -> variable that it holds at present
    constants: dict[int, float] = {}  # what these hold, where that is known
    statements = []
    for k in range(function.n_instructions()):
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if function.instruction_id(k) == ca.OP_OUTPUT:
            place, value = _place(function.sparsity_out(given[0]), given[1]), names[taken[0]]
            statements.append(Statement("", f"r{given[0]}[{place}] = {value}", (value,)))
            continue
        statements.append(_statement(function, k, names, constants))
        names[given[0]] = statements[-1].target
        constants.pop(given[0], None)
        if function.instruction_id(k) == ca.OP_CONST:
            constants[given[0]] = function.instruction_constant(k)
    return statements


def _statement(function: ca.Function, k: int, names, constants) -> Statement:
    operation, taken = function.instruction_id(k), function.instruction_input(k)
    if operation == ca.OP_INPUT:
        place = _place(function.sparsity_in(taken[0]), taken[1])
        return Statement(f"v{k}", f"a{taken[0]}[{place}]", ())
    if operation == ca.OP_CONST:
        return Statement(f"v{k}", f"all({function.instruction_constant(k)!r})", ())
    values = tuple(names[i] for i in taken)
    if operation == ca.OP_DIV and constants.get(taken[1], 0.0) and taken[0] not in constants:
        # a division takes as long as five products
        return Statement(f"v{k}", f"{values[0]} * {1 / constants[taken[1]]!r}", values)
    text = EXPRESSIONS[operation].format(*values)
    if operation == ca.OP_CONSTPOW and constants.get(taken[1]) == 1 / 3:
        text = f"lane_cbrt({values[0]})"
    call = re.match(r"lane_(\w+)\(", text)
    name = call[1] if call and call[1] in (*UNARY, *BINARY) and call[1] not in PROCESSORS_OWN else ""
    return Statement(f"v{k}", text, values, name, values if name in BINARY else values[:1])


def _packed(statements: list[Statement]) -> list[str]:
    """Return the lines of statements for single numbers, the same functions called together.

    Statements are put in order of the number of calls that they have to wait for, one after the other; calls
    of one function that wait for as many do not wait for each other.
    """
    waits: dict[str, int] = {}
    order: dict[int, tuple[list[Statement], dict[str, list[Statement]]]] = {}
    for one in statements:
        level = max((waits[name] for name in one.given), default=0)
        plain, calls = order.setdefault(level, ([], {}))
        if one.call:
            calls.setdefault(one.call, []).append(one)
        else:
            plain.append(one)
        if one.target:
            waits[one.target] = level + bool(one.call)
    lines = []
    for level in sorted(order):
        plain, calls = order[level]
        lines += [str(one) for one in plain]
        for name, together in calls.items():
            for start in range(0, len(together), PACK):
                lines += _called(name, together[start : start + PACK])
    return lines


def _called(name: str, together: list[Statement]) -> list[str]:
    """Return the lines that call a function for several numbers; the unused places repeat the last one."""
    places = [*together, *[together[-1]] * (PACK - len(together))]
    columns = zip(*(one.arguments for one in places), strict=True)
    given = ", ".join(f"(pack){{{', '.join(column)}}}" for column in columns)
    result = f"p{together[0].target}"
    return [
        f"  pack {result} = pack_{name}({given});",
        *(f"  lane {one.target} = {result}[{i}];" for i, one in enumerate(together)),
    ]


def _place(sparsity: ca.Sparsity, nonzero: int) -> int:
    """Return the place of a nonzero in the dense column."""
    return sparsity.find()[nonzero]


def _elementwise(name: str, value: str, lanes: int, kind: str = "lane") -> str:
    """Return the function `lane_NAME` (or of another kind) from what it is for numbers a, b, c."""
    at = "" if lanes == 1 else "[i]"
    # seen through, equal lanes would be taken one by one, by functions that round otherwise
    whole = lanes > 1 and name in (*UNARY, *BINARY) and name not in PROCESSORS_OWN
    letters = [letter for letter in "abc" if re.search(rf"\b{letter}\b", value)]
    return ELEMENTWISE.format(
        attribute="__attribute__((noipa))" if whole else "inline",
        type=kind, name=name, lanes=lanes, at=at,
        given=", ".join(f"{kind} {letter}" for letter in letters),
        value=re.sub(r"\b([abc])\b", rf"\1{at}", value),
    )  # fmt: skip
