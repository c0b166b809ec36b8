# SPDX-License-Identifier: Apache-2.0
"""C++ source that evaluates CasADi functions for several sets of numbers at once.

CasADi writes its functions for a type of number that is given. Here this is a `lane`: a vector of one value a
set, which the compiler maps onto the processor's vector registers, however wide these are.
"""

import re
from collections.abc import Iterable
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
    "-x", "c++", "-std=c++17", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math",
    "-fno-signed-zeros", "-fassociative-math", "-freciprocal-math", "-fno-exceptions", "-fPIC", "-shared",
    "-Wl,-z,defs", "-Wno-psabi",
)  # fmt: skip
HEADER = """/* {processor} */
#include <math.h>
typedef long long casadi_int;
#define LANES {lanes}
static inline double where(double a, double b) {{ return a != 0 ? b : 0.0; }}
static inline double larger(double a, double b) {{ return a > b ? a : b; }}
static inline double smaller(double a, double b) {{ return a < b ? a : b; }}
static inline double absolute(double a) {{ return a < 0 ? -a : a; }}
static inline double sign(double a) {{ return (a > 0) - (a < 0); }}
static inline double power(double a, double b) {{ return b == 1.0 / 3 ? cbrt(a) : pow(a, b); }}
#if LANES == 1
typedef double lane;
#else
struct lane {{
  typedef double vector __attribute__((vector_size(8 * LANES)));
  vector v;
  lane() {{}}
  lane(double value) : v(value - vector{{}}) {{}}
  lane(vector values) : v(values) {{}}
}};
#define EACH(value) lane r; _Pragma("omp simd") for (int i = 0; i < LANES; i++) r.v[i] = value; return r;
#define ARITHMETIC(o) static inline lane operator o(lane a, lane b) {{ return a.v o b.v; }} \\
  static inline lane& operator o##=(lane& a, lane b) {{ a.v = a.v o b.v; return a; }}
#define CHOICE(o) static inline lane operator o(lane a, lane b) {{ EACH(a.v[i] o b.v[i] ? 1.0 : 0.0) }}
#define UNARY(f) static inline lane f(lane a) {{ EACH(f(a.v[i])) }}
#define BINARY(f) static inline lane f(lane a, lane b) {{ EACH(f(a.v[i], b.v[i])) }}
#ifdef VECTOR_MATHEMATICS  // of most of its functions the mathematics library has versions for whole vectors
#define DECLARED _Pragma("omp declare simd notinbranch") extern "C" double
#else
#define DECLARED extern "C" double
#endif
// seen through, equal lanes would be taken one by one, by functions that round otherwise
#define LIBRARY(f) DECLARED f(double) noexcept; __attribute__((noipa)) UNARY(f)
#define LIBRARY2(f) DECLARED f(double, double) noexcept; __attribute__((noipa)) BINARY(f)
LIBRARY(sin) LIBRARY(cos) LIBRARY(tan) LIBRARY(asin) LIBRARY(acos) LIBRARY(atan) LIBRARY(exp) LIBRARY(log)
LIBRARY(sinh) LIBRARY(cosh) LIBRARY(tanh) LIBRARY(asinh) LIBRARY(acosh) LIBRARY(atanh) LIBRARY(cbrt)
LIBRARY2(pow) LIBRARY2(atan2) BINARY(fmod) UNARY(sqrt) UNARY(floor) UNARY(ceil)
ARITHMETIC(+) ARITHMETIC(-) ARITHMETIC(*) ARITHMETIC(/)
CHOICE(<) CHOICE(<=) CHOICE(==) CHOICE(!=) CHOICE(&&) CHOICE(||)
UNARY(absolute) UNARY(sign) BINARY(where) BINARY(larger) BINARY(smaller)
static inline lane operator-(lane a) {{ return -a.v; }}
static inline lane operator!(lane a) {{ return a == 0.0; }}
static inline lane power(lane a, lane b) {{
  for (int i = 0; i < LANES; i++) if (b.v[i] != 1.0 / 3) return pow(a, b);
  return cbrt(a);
}}
#endif
static inline lane load(const double* from) {{ lane r; __builtin_memcpy(&r, from, sizeof r); return r; }}
static inline void store(double* to, lane a) {{ __builtin_memcpy(to, &a, sizeof a); }}
static inline lane casadi_sq(lane a) {{ return a * a; }}
template <auto function, class... Given> static void call(lane* result, const Given*... given) {{
  const lane* arguments[] = {{given...}};
  lane* results[] = {{result}};
  function(arguments, results, nullptr, nullptr, 0);
}}
"""
RENAMED = {
    "casadi_fmax": "larger", "casadi_fmin": "smaller", "casadi_fabs": "absolute", "casadi_sign": "sign",
    "casadi_real": "lane", "pow": "power",
}  # fmt: skip


def source(functions: Iterable[ca.Function], lanes: int) -> str:
    """Return functions of lanes, one output each, which `call<NAME>(output, inputs...)` evaluates."""
    generator = ca.CodeGenerator("lanes.cpp", {"cpp": True, "with_export": False})
    for function in functions:
        generator.add(function)
    _, sparsities, code = generator.dump().partition("static const casadi_int casadi_s0")
    code = re.sub(r"\((a\d+)\?(a\d+):0\)", r"where(\1, \2)", code)
    code = re.sub(rf"\b({'|'.join(RENAMED)})\b", lambda name: RENAMED[name[0]], code)
    return HEADER.format(processor=processor(), lanes=lanes) + sparsities + code


def library(name: str, code: str) -> Path | None:
    """Return the library of a source with lanes, built for this processor; None without a compiler."""
    return best_library(name, code, FLAGS, OPTIONS)
