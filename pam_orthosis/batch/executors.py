# SPDX-License-Identifier: Apache-2.0
"""Where units are worked off: behind one interface, that of `concurrent.futures.Executor`.

On this machine some at a time, each in a process of its own; on a cluster by an existing Dask scheduler.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib.util import find_spec

from pam_orthosis.batch.unit import end_all
from pam_orthosis.errors import OrthosisError

PATIENCE = "10s"  # until a scheduler has to answer


@contextmanager
def local(workers: int) -> Iterator[tuple[Executor, Callable[[], bool]]]:
    """Yield an executor on this machine (a thread waits for each unit's process), and whether it lives."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield pool, lambda: True
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)  # or the next ones would be begun
        end_all()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, Callable[[], bool]]]:
    """Yield an executor on the workers of a Dask scheduler, and whether it lives.

    Raises:
        OrthosisError: Dask is not installed, nobody answers at the address, or there are no workers.
    """
    if find_spec("distributed") is None:
        raise OrthosisError("a cluster needs Dask: pip install 'distributed>=2024.1'")
    from distributed import Client

    for name in ("distributed", "tornado", "asyncio"):  # what they say of a lost connection is said below
        logging.getLogger(name).setLevel(logging.CRITICAL)

    def connected() -> Client:
        return Client(address, timeout=PATIENCE, set_as_default=False)

    try:
        try:
            client = connected()
        except AssertionError:  # Dask's own, on a starved machine
            client = connected()
    except (OSError, ValueError, ImportError, AssertionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise OrthosisError(f"no Dask scheduler at {address}: {reason}") from None
    try:
        if not client.scheduler_info()["workers"]:
            raise OrthosisError(
                f"the Dask scheduler at {address} has no workers: start `dask worker {address}`"
            )
        yield client.get_executor(pure=False), lambda: client.status == "running"
    finally:
        with suppress(Exception):  # there may be nobody left to say goodbye to
            client.close(timeout=1)
