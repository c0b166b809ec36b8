# SPDX-License-Identifier: Apache-2.0
"""The ROS domain of a process of the tests, which no other run on this host has."""

from contextlib import ExitStack
from functools import lru_cache

from pam_orthosis.nodes.launch import free_domain

CLAIMS = ExitStack()  # for as long as the process lives


@lru_cache(maxsize=1)
def own_domain() -> int:
    """Return its id."""
    return CLAIMS.enter_context(free_domain())
