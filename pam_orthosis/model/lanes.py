# SPDX-License-Identifier: Apache-2.0
"""C source that evaluates a CasADi function for several sets of numbers at once.

Every number of the function becomes a `lane`: a vector of one value a set, which the compiler maps onto the
processor's vector registers, however wide these are.
"""

from __future__ import annotations

import platform
from pathlib import Path

import casadi as ca

from pam_orthosis.model.compiled import COMPILER_FLAGS, shared_library

# tried one after the other: what compilers, processors and mathematics libraries know differs
OPTIONS = (
    ("-march=native", "-mprefer-vector-width=512", "-fopenmp-simd", "-DVECTOR_MATHEMATICS"),
    ("-march=native", "-fopenmp-simd"),
    (),
)
HEADER = """/* {processor} */
#include <math.h>
typedef double lane __attribute__((vector_size({bytes}), aligned({bytes})));
typedef long long mask __attribute__((vector_size({bytes}), aligned({bytes})));
typedef double loose __attribute__((vector_size({bytes}), aligned(8)));
static inline lane all(double value) {{ return value - (lane){{}}; }}
static inline lane chosen(mask where, lane a, lane b) {{
  return (lane)((where & (mask)a) | (~where & (mask)b));
}}
static inline lane truth(mask where) {{ return (lane)(where & (mask)all(1.0)); }}
"""
# of most of its functions the mathematics library has versions for whole vectors
VECTORS = """
#ifdef VECTOR_MATHEMATICS
#pragma omp declare simd notinbranch
#endif"""
ONE_BY_ONE = """{vectors}
extern double {name}({declared});
static inline lane lane_{name}({given}) {{
  lane result;
#pragma omp simd
  for (int i = 0; i < {lanes}; i++) result[i] = {name}({taken});
  return result;
}}
"""
UNARY = ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh",
         "asinh", "acosh", "atanh", "sqrt", "floor", "ceil")  # fmt: skip
BINARY = ("pow", "atan2", "fmod")
PROCESSORS_OWN = ("sqrt", "floor", "ceil", "fmod")  # not in the mathematics library's vectors
EXPRESSIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_FABS: "chosen({0} < 0.0, -{0}, {0})", ca.OP_SIGN: "truth({0} > 0.0) - truth({0} < 0.0)",
    ca.OP_FMAX: "chosen({0} > {1}, {0}, {1})", ca.OP_FMIN: "chosen({0} < {1}, {0}, {1})",
    ca.OP_LT: "truth({0} < {1})", ca.OP_LE: "truth({0} <= {1})", ca.OP_EQ: "truth({0} == {1})",
    ca.OP_NE: "truth({0} != {1})", ca.OP_NOT: "truth({0} == 0.0)",
    ca.OP_AND: "truth(({0} != 0.0) & ({1} != 0.0))", ca.OP_OR: "truth(({0} != 0.0) | ({1} != 0.0))",
    ca.OP_IF_ELSE_ZERO: "chosen({0} != 0.0, {1}, all(0.0))",
    ca.OP_CONSTPOW: "lane_pow({0}, {1})",
    **{getattr(ca, f"OP_{name.upper()}"): f"lane_{name}({{0}})" for name in UNARY},
    **{getattr(ca, f"OP_{name.upper()}"): f"lane_{name}({{0}}, {{1}})" for name in BINARY},
}  # fmt: skip


def header(lanes: int) -> str:
    """Return the types and functions that the other sources need, for this processor."""
    helpers = [_one_by_one(name, 1, lanes) for name in UNARY] + [_one_by_one(n, 2, lanes) for n in BINARY]
    return HEADER.format(processor=_processor(), bytes=8 * lanes) + "".join(helpers)


def source(function: ca.Function) -> str:
    """Return a C function of lanes for an SX function: pointers to its inputs, then to its outputs, dense."""
    inputs = [f"const lane* restrict a{i}" for i in range(function.n_in())]
    outputs = [f"lane* restrict r{i}" for i in range(function.n_out())]
    work = ", ".join(f"w{i}" for i in range(function.sz_w()))
    lines = [f"static void {function.name()}({', '.join(inputs + outputs)}) {{"]
    lines += [f"  lane {work};"] if work else []
    lines += [f"  {_statement(function, k)};" for k in range(function.n_instructions())]
    return "\n".join([*lines, "}", ""])


def library(name: str, code: str) -> Path | None:
    """Return the library of a source with lanes, built for this processor; None without a compiler."""
    return next(
        (built for options in OPTIONS if (built := shared_library(name, code, _flags(options)))), None
    )


def _flags(options: tuple[str, ...]) -> tuple[str, ...]:
    # an unknown function of the mathematics library is found now, not when it is called
    return (*COMPILER_FLAGS, "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi", "-Wl,-z,defs", *options)


def _statement(function: ca.Function, k: int) -> str:
    operation = function.instruction_id(k)
    taken, given = function.instruction_input(k), function.instruction_output(k)
    if operation == ca.OP_INPUT:
        return f"w{given[0]} = a{taken[0]}[{_place(function.sparsity_in(taken[0]), taken[1])}]"
    if operation == ca.OP_OUTPUT:
        return f"r{given[0]}[{_place(function.sparsity_out(given[0]), given[1])}] = w{taken[0]}"
    if operation == ca.OP_CONST:
        return f"w{given[0]} = all({function.instruction_constant(k)!r})"
    return f"w{given[0]} = " + EXPRESSIONS[operation].format(*(f"w{i}" for i in taken))


def _place(sparsity: ca.Sparsity, nonzero: int) -> int:
    """Return the place of a nonzero in the dense column."""
    return sparsity.find()[nonzero]


def _one_by_one(name: str, arguments: int, lanes: int) -> str:
    letters = "ab"[:arguments]
    return ONE_BY_ONE.format(
        vectors="" if name in PROCESSORS_OWN else VECTORS,
        name=name,
        lanes=lanes,
        declared=", ".join("double" for _ in letters),
        given=", ".join(f"lane {letter}" for letter in letters),
        taken=", ".join(f"{letter}[i]" for letter in letters),
    )


def _processor() -> str:
    """Return what tells processors apart, lest a library built on another one is taken from the cache."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())
