# SPDX-License-Identifier: Apache-2.0
"""Several fits at once: kernels and matrix products leave the interpreter to other threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import threadpool_limits

from pam_orthosis.progress import Progress, silent

THREADS = 2
One = TypeVar("One")
Result = TypeVar("Result")


def together(
    function: Callable[[One], Result],
    items: Sequence[One],
    progress: Progress = silent,
    what: str = "fitting",
) -> list[Result]:
    """Return what a function gives for each item, in their order; raises what it raises.

    A matrix product that shares itself out over threads would wait for those that are busy.
    """
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(THREADS) as pool:
        results = []
        progress(what, 0, len(items))
        for result in pool.map(function, items):
            results.append(result)
            progress(what, len(results), len(items))
        return results
