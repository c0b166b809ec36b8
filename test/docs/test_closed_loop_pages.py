# SPDX-License-Identifier: Apache-2.0
"""The pages on learning and on controllers compared show what the committed results say."""

import json
import sys
from pathlib import Path

import pytest

from pam_orthosis.report import improvement

ROOT = Path(__file__).resolve().parents[2]
DOCS, RESULTS = ROOT / "docs", ROOT / "benchmarks" / "control_campaign" / "results.jsonl"
sys.path.insert(0, str(ROOT / "benchmarks"))

import bench_control  # noqa: E402

LEARNED = sorted((DOCS / "studies").glob("improve-*.json"))


@pytest.mark.parametrize("file", LEARNED, ids=lambda file: file.stem)
def test_the_page_on_learning_shows_the_table_of_its_run(file):
    table = improvement.table(json.loads(file.read_text()))
    assert table.count("\n") >= 4
    assert table in (DOCS / "improve.md").read_text()


@pytest.mark.parametrize("file", ["results.jsonl", "fresh.jsonl"])
def test_the_page_on_controllers_shows_the_table_of_its_results(file):
    table = bench_control.table(RESULTS.with_name(file))
    assert table.count("\n") >= 3
    assert table in (DOCS / "benchmark.md").read_text()


def test_the_page_on_controllers_shows_what_supply_a_person_takes():
    table = bench_control.supply(RESULTS)
    assert table.count("\n") >= 10
    assert table in (DOCS / "benchmark.md").read_text()


def test_figures_of_both_pages_are_there():
    for page, picture in (("improve", "improve.png"), ("benchmark", "controllers.png")):
        assert f"pictures/{picture}" in (DOCS / f"{page}.md").read_text()
        assert (DOCS / "pictures" / picture).read_bytes().startswith(b"\x89PNG")
