# SPDX-License-Identifier: Apache-2.0
"""In how many digits a value is printed beside its interval."""

import math

MOST_DIGITS = 9
NARROWEST = 1e-7  # of a value: no recording shows more, and a fit that says so does not know its interval
UNKNOWN = "interval unknown"


def digits(lower: float, upper: float, fewest: int) -> int:
    """Return so many that both ends of an interval show two of its width."""
    width, largest = upper - lower, max(abs(lower), abs(upper))
    if not 0 < width < largest:
        return fewest
    return min(max(fewest, 1 + math.ceil(math.log10(largest / width))), MOST_DIGITS)


def interval_words(lower: float, upper: float, shown: int, between: str, unit: str = "") -> str:
    """Return an interval in so many digits; that it is unknown where it has no width."""
    if not upper - lower > NARROWEST * max(abs(lower), abs(upper)):
        return UNKNOWN
    return f"{lower:.{shown}g} {between} {upper:.{shown}g}{unit}"


def in_short(size: tuple[float, str]) -> str:
    """Return a number with its unit, in few digits."""
    return f"{size[0]:.3g}{of_unit(size[1])}"


def of_unit(unit: str) -> str:
    """Return a unit as it follows a number: a pure number has none."""
    return "" if unit in ("-", "1") else f" {unit}"
