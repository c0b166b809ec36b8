# SPDX-License-Identifier: Apache-2.0
"""The README speaks of what exists."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

from pam_orthosis.cli.main import VERBS, verb_parser

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_generated_blocks_are_up_to_date():
    result = subprocess.run([sys.executable, ROOT / "docs" / "generate.py", "--check"], check=False)
    assert result.returncode == 0, "run `python docs/generate.py` and commit what it changes"


def test_every_command_is_a_verb_and_every_verb_is_shown():
    shown = set(re.findall(r"^ {4}pam-orthosis ([a-z][\w-]*)", README, flags=re.M))
    assert shown
    assert shown <= set(VERBS)
    assert set(VERBS) <= shown


def test_every_command_is_one_that_the_program_takes():
    lines = re.findall(r"^ {4}pam-orthosis (\S+)(.*?)(?: {2,}#.*)?$", README, flags=re.M)
    assert {verb for verb, _ in lines} == set(VERBS)
    for verb, arguments in lines:
        verb_parser(verb).parse_args(shlex.split(arguments))


def test_it_is_short_and_its_picture_small():
    assert len(README.splitlines()) <= 150
    (picture,) = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    assert (ROOT / picture).stat().st_size < 2_000_000


def test_every_linked_file_exists():
    targets = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


def test_the_two_commands_are_targets_of_the_makefile():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in ("run", "test"):
        assert f"make {command}" in README
        assert re.search(rf"^{command}:", makefile, flags=re.M)
