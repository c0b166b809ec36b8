# SPDX-License-Identifier: Apache-2.0
"""The page of commands, from the parsers of the verbs."""

import argparse

from generators.markdown import table
from pam_orthosis.cli.help_texts import ANSWERS, EXAMPLES, statuses
from pam_orthosis.cli.main import VERBS, verb_parser

HEAD = """# Commands

`pam-orthosis VERB`, or `ros2 run pam_orthosis pam-orthosis VERB`. `pam-orthosis VERB --help` prints what
this page holds. `--json` prints the answer for scripts.

"""


def pages() -> dict[str, str]:
    """Return the page."""
    index = table(("verb", "purpose"), ((f"[`{verb}`](#{verb})", words) for verb, words in VERBS.items()))
    return {"reference/cli.md": HEAD + index + "".join(_section(verb) for verb in VERBS)}


def exit_table() -> str:
    """Return what 0 and 1 mean for each verb as a table."""
    rows = ((f"`{verb}`", good, no or "-") for verb, (good, no) in ANSWERS.items())
    return table(("verb", "0", "1"), rows)


def _section(verb: str) -> str:
    parser = verb_parser(verb)
    parts = [f"\n## {verb}\n\n{parser.description}\n\n```text\n{_usage(parser)}\n```\n\n"]
    rows = [(_name(action), _words(action)) for action in parser._actions if action.dest != "help"]
    parts += [
        table(("argument", "meaning"), rows),
        "\nExamples:\n\n```sh\n",
        "\n".join(EXAMPLES[verb]),
        "\n```\n",
    ]
    parts.append(f"\nExit status: {statuses(verb)}.\n")
    return "".join(parts)


def _usage(parser: argparse.ArgumentParser) -> str:
    return parser.format_usage().removeprefix("usage: ").strip()


def _name(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or ())
    metavar = metavar or ("|".join(map(str, action.choices)) if action.choices else "")
    return f"`{' '.join(filter(None, [*action.option_strings[:1], metavar if action.nargs != 0 else '']))}`"


def _words(action: argparse.Action) -> str:
    return (action.help or "").replace("%%", "%")
