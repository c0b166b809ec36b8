# SPDX-License-Identifier: Apache-2.0
"""C source that replays stretches of a recording side by side.

The functions are CasADi's; what they read and write of a stretch lies beside the same of the others, so that
a compiler makes one vector of it.
"""

import re
from collections.abc import Iterable
from importlib.metadata import version

import casadi as ca

from pam_orthosis.discrepancy.replay.lanes import LANES
from pam_orthosis.errors import OrthosisError

# the library's extremes are calls, and these keep what is not a number in the second argument; a cubic root
# is cheaper than a power
HEAD = """
#include <math.h>
#define LANES {lanes}
#define fmax(x, y) ((x) > (y) ? (x) : (y))
#define fmin(x, y) ((x) < (y) ? (x) : (y))
#ifdef VECTOR_MATHEMATICS
#define VECTOR __attribute__((simd("notinbranch"))) double
VECTOR exp(double); VECTOR log(double); VECTOR sin(double); VECTOR cos(double); VECTOR tanh(double);
VECTOR asinh(double); VECTOR cbrt(double); VECTOR pow(double, double);
#endif
static inline double power(double a, double b) {{ return b == 1.0 / 3 ? cbrt(a) : pow(a, b); }}
#define pow power
"""
# the arguments that differ from stretch to stretch
BESIDE = {
    "orthosis_observe": (0, 1), "orthosis_rates": (0, 1, 5), "orthosis_held": (0,), "orthosis_fixed": (),
}  # fmt: skip
LOOP = """
static void rk4(double* x, const double* z, const double* theta, const double* period,
                const double* held, double at, double h) {{
  double k[4][{states} * LANES], y[{states} * LANES], part = h / *period;
  for (int i = 0; i < {states} * LANES; i++) y[i] = x[i];
  for (int s = 0; s < 4; s++) {{
    double f = at + (s == 0 ? 0 : s == 3 ? part : 0.5 * part), w = s == 2 ? h : 0.5 * h;
    orthosis_rates(y, z, theta, period, &f, held, k[s]);
    if (s < 3) for (int i = 0; i < {states} * LANES; i++) y[i] = x[i] + w * k[s][i];
  }}
  for (int i = 0; i < {states} * LANES; i++) x[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
}}

static void phase(double* x, const double* z, const double* theta, const double* period,
                  const double* fixed, double from, double to, long steps) {{
  double held[{held} * LANES], share = (to - from) / steps;
  orthosis_held(z, theta, period, fixed, held);
  for (long j = 0; j < steps; j++) rk4(x, z, theta, period, held, from + j * share, share * *period);
}}

static void keep(double* place, const double* x) {{
  for (int i = 0; i < {states} * LANES; i++) place[i] = x[i];
}}

void orthosis_replay(long n, long warm, long first, long rest, double period, const double* z,
                     const double* theta, const double* start, double* result,
                     double* begun, double* ended) {{
  double x[{states} * LANES], next[{states} * LANES], fixed[{fixed}], before[{data} * LANES];
  orthosis_fixed(theta, &period, fixed);
  keep(x, start);
  for (long k = 0;; k++, z += {data} * LANES, result += {results} * LANES) {{
    if (k == warm) keep(begun, x);
    if (k == n) break;
    orthosis_observe(x, z, theta, &period, next, result);
    keep(x, next);
    double at = first ? z[{data} * LANES - 1] : 0;
    if (first) {{
      for (int i = 0; i < {data} * LANES; i++) before[i] = z[i];
      {switched}
      phase(x, before, theta, &period, fixed, 0, at, first);
    }}
    phase(x, z, theta, &period, fixed, at, 1, rest);
  }}
  keep(ended, x);
}}
"""
READ = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
WRITTEN = re.compile(r"if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]")


def source(functions: Iterable[ca.Function], switches: Iterable[tuple[int, int]]) -> str:
    """Return the source for observe, rates, held and fixed; switches: as of a part."""
    observe, rates, held, fixed = functions
    generator = ca.CodeGenerator("replay.c")
    for function in (observe, rates, held, fixed):
        generator.add(function)
    code = generator.dump()
    head, *_ = code.partition(f"/* {observe.name()}:")
    helpers = re.sub(r"^casadi_real casadi_", "static inline casadi_real casadi_", head, flags=re.MULTILINE)
    loop = LOOP.format(
        states=rates.size1_in(0), data=rates.size1_in(1), results=observe.size1_out(1),
        fixed=max(1, fixed.size1_out(0)), held=max(1, held.size1_out(0)),
        switched=" ".join(
            f"for (int l = 0; l < LANES; l++) before[{now} * LANES + l] = before[{old} * LANES + l];"
            for old, now in switches
        ),
    )  # fmt: skip
    whole = [_side_by_side(function, code) for function in (observe, rates, held, fixed)]
    return HEAD.format(lanes=LANES) + helpers + "".join(whole) + loop


def _side_by_side(function: ca.Function, code: str) -> str:
    """Return a function of CasADi's source as one that computes all stretches."""
    _, _, after = code.partition(f"/* {function.name()}:")
    body = after[after.index("{") + 1 : after.index("return 0;")]
    beside = BESIDE[function.name()]

    def read(place: re.Match[str]) -> str:
        argument, element = int(place[1]), place[2]
        return f"i{argument}[{element} * LANES + l]" if argument in beside else f"i{argument}[{element}]"

    written = r"o\1[\2 * LANES + l]" if beside else r"o\1[\2]"
    body = WRITTEN.sub(written, READ.sub(read, body))
    if "arg[" in body or "res[" in body:
        raise OrthosisError(f"CasADi {version('casadi')} writes C that is not known here; install CasADi 3.8")
    arguments = [f"const double* i{i}" for i in range(function.n_in())]
    results = [f"double* restrict o{i}" for i in range(function.n_out())]
    loop = "#pragma omp simd\nfor (int l = 0; l < LANES; l++)" if beside else ""
    return (
        f"static inline void {function.name()}({', '.join(arguments + results)}) {{\n{loop} {{{body}}}\n}}\n"
    )
