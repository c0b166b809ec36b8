# SPDX-License-Identifier: Apache-2.0
"""Values are put into a YAML text, and nothing else of it changes."""

import pytest
import yaml

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.rows import replaced
from pam_orthosis.model import parameters

BLOCK = """\
# muscles
m:  # the small one
    a:
        value:  # two coefficients
            - 1.0  # first
            - 2.0e-8  # second
        # whose
        source: |
            long
            text
        unit:   m
    b: {source: old, value: 6.839547937705168e-8,  unit: m}  # kept
"""
EDITED = """\
# muscles
m:  # the small one
    a:
        value:  # two coefficients
            [9.0, 8.0]  # second
        # whose
        source: "new"
        unit:   m
    b: {source: old, value: 6.839547937705168e-8,  unit: m}  # kept
"""


def test_all_that_is_not_replaced_keeps_every_character():
    text = replaced(BLOCK, {"m.a.value": "[9.0, 8.0]", "m.a.source": '"new"'}, "f.yaml")
    assert text == EDITED
    windows = BLOCK.replace("\n", "\r\n")
    assert replaced(windows, {"m.b.value": "1.0"}, "f.yaml") == windows.replace("6.839547937705168e-8", "1.0")


def test_each_row_of_the_shipped_file_can_be_replaced_by_itself():
    text = (parameters.config_folder() / "muscle.yaml").read_text()
    before = yaml.safe_load(text)
    keys = [
        row.key.removeprefix("muscle.") for row in parameters.load().rows() if row.key.startswith("muscle.")
    ]
    assert len(keys) > 30
    for key in keys:
        *path, leaf = key.split(".")
        after = yaml.safe_load(replaced(text, {f"{key}.value": "[7.0, 7.5]"}, "f.yaml"))
        node = after
        for step in path:
            node = node[step]
        assert node[leaf]["value"] == [7.0, 7.5]
        expected = before
        for step in key.split("."):
            expected = expected[step]
        node[leaf]["value"] = expected["value"]
        assert after == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &x {value: 1}\nb: *x\n", "has aliases"),
        ("a: {value: 1, value: 2}", "is there twice"),
        ("a: {unit: m}", "has no a.value"),
        ("a:\n  value:\n  unit: m", "has no a.value"),
        ("a: [1]", "has no a.value"),
        ("- 1", "has no a.value"),
        ("", "has no a.value"),
        ("a: [", "is not valid YAML"),
    ],
)
def test_a_text_without_the_row_or_with_shared_values_is_refused(text, message):
    with pytest.raises(OrthosisError, match=rf"f\.yaml.*{message}"):
        replaced(text, {"a.value": "7"}, "f.yaml")
