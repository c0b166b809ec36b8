# SPDX-License-Identifier: Apache-2.0
"""Words that advise options of a verb, for who calls Python: `--model` is the argument `model` there."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from pam_orthosis.errors import OrthosisError

MAPPED = re.compile(r"--columns (\w+)=(-?COLUMN)\b")
NAMES = "columns|degrees|held-out|jobs|machine|model|muscle|namespace|nominal-length-m|system"
OPTION = re.compile(rf"(?<![\w-])--({NAMES})(?![\w-])")
OWN = {"nominal-length-m": "nominal_length", "held-out": "held_out"}  # argument of another name
OUT = "another --out"


def in_python(words: str) -> str:
    """Return words with options of verbs as the arguments of the library's functions."""
    words = MAPPED.sub(r'`columns={"\1": "\2"}`', words).replace(OUT, "another path")
    return OPTION.sub(lambda found: f"`{OWN.get(found[1], found[1])}`", words)


@contextmanager
def arguments_named() -> Iterator[None]:
    """Let a refusal name arguments of Python in the place of a verb's options."""
    try:
        yield
    except OrthosisError as error:
        raise type(error)(in_python(str(error))) from None
