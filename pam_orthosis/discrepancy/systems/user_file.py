# SPDX-License-Identifier: Apache-2.0
"""A user's own system from a Python file with `system() -> System`; the file is run when a user gives it."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import Any

from pam_orthosis.discrepancy.systems.foreign import LONGEST_SECONDS, Endless, called
from pam_orthosis.discrepancy.systems.soundness import check_system
from pam_orthosis.discrepancy.systems.system import Assembled, System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import read_text

MODULE = "pam_orthosis_user_system"
MAKER = "system"
LONGEST = 300  # characters of what the file's own error says
TRUTH = "truth value of a CasADi"  # in what CasADi says of a condition


def load_system(path: Path) -> System:
    """Return the system that a file defines; what it prints goes to stderr, and nothing is written beside it.

    Raises:
        OrthosisError: the file cannot be run, has no function `system`, or that one returns no sound system.
    """
    text = read_text(path)
    module = ModuleType(MODULE)
    module.__file__ = str(path)
    sys.modules[MODULE] = module  # dataclasses look there for the types of their fields
    with _named(path):
        with called():
            exec(compile(text, str(path), "exec", dont_inherit=True), module.__dict__)
        make = getattr(module, MAKER, None)
        if not callable(make):
            raise OrthosisError(f"it has no function {MAKER}() that returns a System")
        with called():
            system = make()
        if not isinstance(system, System):
            raise OrthosisError(
                f"{MAKER}() returns {type(system).__name__}, not a System (Model(...).system())"
            )
        guarded = _guarded(path, system)
        check_system(guarded)
    return guarded


def _guarded(path: Path, system: System) -> System:
    """Return a system whose errors name the file, when the engine calls back into it too."""

    def assemble(effects: tuple[str, ...]) -> Assembled:
        with _named(path), called():
            return system.assemble(effects)

    def made(make: Callable[..., System], *given: Mapping[str, Any]) -> System:
        try:
            with called():
                other = make(*given)
        except OrthosisError:  # of what was given, not of the file
            raise
        except BaseException:
            with _named(path):
                raise
        return _guarded(path, other)

    return replace(
        system,
        assemble=assemble,
        changed=None if system.changed is None else partial(made, system.changed),
        simpler={name: partial(made, make) for name, make in system.simpler.items()},
    )


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Let whatever fails in a user's file become one line that names the file, and the line in it."""
    try:
        yield
    except KeyboardInterrupt:  # of who runs it
        raise
    except BaseException as error:
        if isinstance(error, OrthosisError) and str(path) in str(error):  # of a call inside of this one
            raise
        raise OrthosisError(f"{path}{_line(path, error)}: {_told(error)}") from error


def _told(error: BaseException) -> str:
    """Return what is wrong, in words of who writes a system."""
    if isinstance(error, OrthosisError):
        return str(error)
    if isinstance(error, Endless):
        return f"no answer after {LONGEST_SECONDS:.0f} s of computing: does this loop end?"
    said = " ".join(str(error).split())
    if TRUTH in said:
        return (
            "a signal has no value yet, so `if`, `while`, `and`, `or`, min and max cannot look at it: write"
            " ca.if_else(condition, a, b), ca.logic_and, ca.logic_or, ca.fmin, ca.fmax"
        )
    return f"{type(error).__name__}: {said[:LONGEST]}"


def _line(path: Path, error: BaseException) -> str:
    """Return in which line of the file an error came up, if in one."""
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return f", line {error.lineno}"
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f", line {lines[-1]}" if lines else ""
