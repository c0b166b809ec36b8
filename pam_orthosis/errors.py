# SPDX-License-Identifier: Apache-2.0
"""The errors that a user can cause or meet; the entry script turns each into one line."""

from collections.abc import Iterator
from contextlib import contextmanager


class OrthosisError(Exception):
    """Unusable input or usage: the message says what is wrong and what to do (exit status 2)."""

    exit_status = 2


class RunFailed(OrthosisError):
    """A node died, did not answer or could not be started (exit status 3)."""

    exit_status = 3


@contextmanager
def naming(what: object) -> Iterator[None]:
    """Let a refusal begin with what is refused, such as a file, unless it names that already."""
    try:
        yield
    except OrthosisError as error:
        if what is None or str(what) in str(error):
            raise
        raise type(error)(f"{what}: {error}") from error
