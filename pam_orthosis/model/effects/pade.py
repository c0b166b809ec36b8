# SPDX-License-Identifier: Apache-2.0
"""A pure delay as a rational function, for models that need ordinary differential equations.

Pade approximation (2, 3) of exp(-s T): numerator 1 - 2/5 sT + 1/20 (sT)^2, denominator
1 + 3/5 sT + 3/20 (sT)^2 + 1/60 (sT)^3. Its phase is that of the delay within 1 % up to 2 pi f T = 2.5,
and a step does not show at the output at once. A replay of recorded samples may shift them instead.
"""

from pam_orthosis.model.signals import Expression


def chain(states: tuple[Expression, ...], value: Expression, delay: Expression) -> tuple[Expression, ...]:
    """Return the rates of the three states, driven by a signal."""
    a, b, c = states
    return b / delay, c / delay, (value - 60 * a - 36 * b - 9 * c) / delay


def delayed(states: tuple[Expression, ...]) -> Expression:
    """Return the delayed signal."""
    a, b, c = states
    return 60 * a - 24 * b + 3 * c


def lost(states: tuple[Expression, ...], delay: Expression) -> Expression:
    """Return x(t) - x(t - T) of a signal x by whose derivative the chain is driven."""
    a, b, c = states
    return delay * (60 * a + 6 * b + c)
