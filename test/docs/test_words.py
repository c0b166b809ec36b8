# SPDX-License-Identifier: Apache-2.0
"""Pages, help and examples use the words of the field."""

import re
from pathlib import Path

import pytest

from pam_orthosis.cli.main import VERBS, verb_parser

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
]
# private words, and words of a history
PRIVATE = re.compile(
    r"\b(is|are|was) told\b|\btells\b|\bbelie(f|ve[sd]?)\b|\bordinary parameters\b|\blook-alikes?\b"
    r"|\bhardly tell\b|\blet go\b|\brid of\b|\btaken back\b|\bcogwheel\b|\bby a hair\b"
    r"|\bwhat the model lacks\b"
    r"|\bsince then\b|\bno longer\b|\bas it was\b|\b20\d\d-\d\d|\b(November|December) 20",
    re.IGNORECASE,
)
ALLOWED = {"explanation/glossary.md": {"cogwheel"}}  # the paper's word, once


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_use_the_words_of_the_field(page):
    text = page.read_text(encoding="utf-8")
    found = {one[0].lower() for one in PRIVATE.finditer(text)}
    assert found <= ALLOWED.get("/".join(page.parts[-2:]), set()) | {"look_alikes"}


@pytest.mark.parametrize("verb", VERBS)
def test_help_uses_the_words_of_the_field(verb):
    assert not PRIVATE.findall(verb_parser(verb).format_help())


def test_private_words_are_found():
    assert PRIVATE.search("The cause is told below.")
    assert PRIVATE.search("as believed by the controllers")
    assert not PRIVATE.search("The verdict is printed.")
