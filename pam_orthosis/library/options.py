# SPDX-License-Identifier: Apache-2.0
"""Words that advise options of a verb, for who calls Python: `--model` is the argument `model` there."""

import re

MAPPED = re.compile(r"--columns (\w+)=(-?COLUMN)\b")
OPTION = re.compile(r"(?<![\w-])--(columns|jobs|machine|model|namespace)(?![\w-])")


def in_python(words: str) -> str:
    """Return words with options of verbs as the arguments of the library's functions."""
    return OPTION.sub(r"`\1`", MAPPED.sub(r'`columns={"\1": "\2"}`', words))
