# SPDX-License-Identifier: Apache-2.0
"""C source that evaluates a CasADi function for several sets of numbers at once.

Every number of the function becomes a `lane`: a vector of one value a set, which the compiler maps onto the
processor's vector registers, however wide these are.
"""

from __future__ import annotations

import re
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
    "-O2", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared",
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
static inline lane all(double value) {{ return value; }}
"""
ELEMENTWISE = """
static {attribute} lane lane_{name}({given}) {{
  lane result;
#pragma omp simd
  for (int i = 0; i < {lanes}; i++) result{at} = {value};
  return result;
}}
"""
# of most of its functions the mathematics library has versions for whole vectors
DECLARED = """
#ifdef VECTOR_MATHEMATICS
#pragma omp declare simd notinbranch
#endif
extern double {name}({types});
"""
UNARY = ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh",
         "asinh", "acosh", "atanh", "sqrt", "floor", "ceil")  # fmt: skip
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
    **{getattr(ca, f"OP_{name.upper()}"): f"lane_{name}({{0}})" for name in UNARY},
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
    types = HEADER_OF_ONE if lanes == 1 else HEADER
    return types.format(processor=processor(), bytes=8 * lanes) + "".join(declared + defined)


def source(function: ca.Function) -> str:
    """Return a C function of lanes for an SX function: pointers to its inputs, then to its outputs, dense."""
    inputs = [f"const lane* restrict a{i}" for i in range(function.n_in())]
    outputs = [f"lane* restrict r{i}" for i in range(function.n_out())]
    work = ", ".join(f"w{i}" for i in range(function.sz_w()))
    lines = [f"static void {function.name()}({', '.join(inputs + outputs)}) {{"]
    lines += [f"  lane {work};"] if work else []
    constants: dict[int, float] = {}  # what the places of the work vector hold, where that is known
    for k in range(function.n_instructions()):
        lines.append(f"  {_statement(function, k, constants)};")
    return "\n".join([*lines, "}", ""])


def library(name: str, code: str) -> Path | None:
    """Return the library of a source with lanes, built for this processor; None without a compiler."""
    return best_library(name, code, FLAGS, OPTIONS)


def _statement(function: ca.Function, k: int, constants: dict[int, float]) -> str:
    operation = function.instruction_id(k)
    taken, given = function.instruction_input(k), function.instruction_output(k)
    if operation == ca.OP_OUTPUT:
        return f"r{given[0]}[{_place(function.sparsity_out(given[0]), given[1])}] = w{taken[0]}"
    if operation == ca.OP_INPUT:
        value = f"a{taken[0]}[{_place(function.sparsity_in(taken[0]), taken[1])}]"
    elif operation == ca.OP_CONST:
        value = f"all({function.instruction_constant(k)!r})"
    elif operation == ca.OP_DIV and constants.get(taken[1], 0.0) and taken[0] not in constants:
        value = f"w{taken[0]} * {1 / constants[taken[1]]!r}"  # a division takes as long as five products
    else:
        value = EXPRESSIONS[operation].format(*(f"w{i}" for i in taken))
    constants.pop(given[0], None)
    if operation == ca.OP_CONST:
        constants[given[0]] = function.instruction_constant(k)
    return f"w{given[0]} = {value}"


def _place(sparsity: ca.Sparsity, nonzero: int) -> int:
    """Return the place of a nonzero in the dense column."""
    return sparsity.find()[nonzero]


def _elementwise(name: str, value: str, lanes: int) -> str:
    """Return the function `lane_NAME` from what it is for numbers a, b, c."""
    at = "" if lanes == 1 else "[i]"
    # seen through, equal lanes would be taken one by one, by functions that round otherwise
    whole = lanes > 1 and name in (*UNARY, *BINARY) and name not in PROCESSORS_OWN
    letters = [letter for letter in "abc" if re.search(rf"\b{letter}\b", value)]
    return ELEMENTWISE.format(
        attribute="__attribute__((noipa))" if whole else "inline",
        name=name, lanes=lanes, at=at, given=", ".join(f"lane {letter}" for letter in letters),
        value=re.sub(r"\b([abc])\b", rf"\1{at}", value),
    )  # fmt: skip
