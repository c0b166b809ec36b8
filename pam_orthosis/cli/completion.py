# SPDX-License-Identifier: Apache-2.0
"""Completion of verbs, options and files for a shell: `eval "$(pam-orthosis --print-completion bash)"`."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import shtab

Parsers = Callable[[], Mapping[str, argparse.ArgumentParser]]
SHELLS = tuple(shtab.SUPPORTED_SHELLS)


class Print(argparse.Action):
    """Print the script of a shell, and end."""

    def __init__(self, *given: Any, parsers: Parsers, **more: Any):
        super().__init__(*given, **more)
        self._parsers = parsers

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> None:
        """Print what completes the arguments of all verbs."""
        print(script(parser.prog, self._parsers(), given[1]))
        parser.exit()


def script(program: str, parsers: Mapping[str, argparse.ArgumentParser], shell: str) -> str:
    """Return the script that completes the arguments of all verbs."""
    whole = argparse.ArgumentParser(program)
    verbs = whole.add_subparsers()
    for name, one in parsers.items():
        for action in one._actions:
            action.choices = list(action.choices) if action.choices else None
            if action.type is Path or action.metavar in ("DIR", "FILE", "BAG"):
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        verbs.add_parser(name, parents=[one], add_help=False, help=(one.description or "").split("\n")[0])
    text: str = shtab.complete(whole, shell=shell)
    return text
