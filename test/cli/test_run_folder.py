# SPDX-License-Identifier: Apache-2.0
"""What `run` does with its folder when the run fails, or another one has it."""

import errno
import shutil

import pytest

from pam_orthosis.bag import recover
from pam_orthosis.cli import run
from pam_orthosis.errors import OrthosisError


@pytest.fixture
def unfinished(tmp_path):
    """The folder of a bag that nobody closed, and one with the nodes' output."""
    bag, work = tmp_path / "bag", tmp_path / "work"
    for folder in (bag, work):
        folder.mkdir()
    (bag / "bag_0.mcap").touch()
    (work / "node.log").write_text("no air")
    return bag, work


def _full(*_arguments, **_options):
    raise shutil.Error([("a", "b", OSError(errno.ENOSPC, "No space left on device"))] * 50)


def test_on_a_full_disk_the_bag_is_recovered_all_the_same(unfinished, monkeypatch):
    bag, work = unfinished
    recovered = []
    monkeypatch.setattr(recover, "recover_in_place", recovered.append)
    monkeypatch.setattr(shutil, "copytree", _full)
    assert run._rescue(bag, work) == f"the bag {bag} holds the run up to there"
    assert recovered == [bag]


def test_what_cannot_be_recovered_is_said_and_the_output_kept(unfinished, monkeypatch):
    def refuse(bag):
        raise OrthosisError(f"{bag} holds no readable message")

    bag, work = unfinished
    monkeypatch.setattr(recover, "recover_in_place", refuse)
    assert run._rescue(bag, work) == f"{bag} holds no readable message"
    assert (bag / "log" / "node.log").read_text() == "no air"
