# SPDX-License-Identifier: Apache-2.0
"""The errors that a user can cause or meet; the entry script turns each into one line."""


class OrthosisError(Exception):
    """Unusable input or usage: the message says what is wrong and what to do (exit status 2)."""

    exit_status = 2


class RunFailed(OrthosisError):
    """A node died, did not answer or could not be started (exit status 3)."""

    exit_status = 3
