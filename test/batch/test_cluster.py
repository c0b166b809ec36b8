# SPDX-License-Identifier: Apache-2.0
"""The same batches on a Dask cluster of this machine."""

import sys

import pytest
from test_batch import WALK, printing

from pam_orthosis.batch import unit as unit_module
from pam_orthosis.batch.batch import Batch
from pam_orthosis.batch.unit import Unit
from pam_orthosis.cli.main import main

distributed = pytest.importorskip("distributed", reason="the extra `cluster`")
HERE = {"processes": False, "dashboard_address": None, "protocol": "tcp", "host": "127.0.0.1"}


@pytest.fixture
def scheduler():
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **HERE) as started:
        yield started


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(unit_module, "PATIENCE", "1s")


def test_the_same_command_on_a_cluster(scheduler, tmp_path, capsys):
    address = scheduler.scheduler_address
    assert address.startswith("tcp://127.0.0.1")
    command = ["batch", "check", str(WALK), str(tmp_path / "gone"), "--out", str(tmp_path / "out")]
    assert main([*command, "--cluster", address]) == 3
    told = capsys.readouterr().out
    assert "failed: gone (2 tries): no bag at" in told
    assert "1 yes, 0 no, 1 failed" in told


def test_a_scheduler_that_goes_away_ends_the_batch_with_one_line(scheduler, tmp_path):
    end = tmp_path / "end"
    waiting = f"while not __import__('os').path.exists({str(end)!r}): __import__('time').sleep(0.1)"
    units = [printing(tmp_path, "one", {}), Unit("long", "timeit", ("-n1", "-r1", waiting), seconds=60)]
    batch = Batch(units, tmp_path / "out")

    def leave(_line):
        end.touch()  # closing waits for what the workers do
        scheduler.close()

    lost = pytest.raises(unit_module.OrthosisError, match="connection to the cluster is lost")
    with lost, unit_module.cluster(scheduler.scheduler_address) as (executor, lives):
        batch.run(executor, lives, 1, leave)
    assert batch.summary()["yes"] == ["one"]
    assert Batch(units, tmp_path / "out").skipped == ("one",)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "127.0.0.1:port"])
def test_nobody_at_the_address_is_one_line_and_exit_2(address, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["batch", "check", str(WALK), "--out", str(out), "--cluster", address]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"pam-orthosis: error: no Dask scheduler at {address}: ")
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_cluster_without_workers_is_told(tmp_path, capsys):
    with distributed.LocalCluster(n_workers=0, **HERE) as started:
        address = started.scheduler_address
        command = ["batch", "check", str(WALK), "--out", str(tmp_path / "out"), "--cluster", address]
        assert main(command) == 2
    assert "has no workers" in capsys.readouterr().err


def test_without_dask_it_says_how_to_get_it(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setattr(unit_module, "find_spec", lambda _: None)
    out = str(tmp_path / "out")
    assert main(["batch", "check", str(WALK), "--out", out, "--cluster", "tcp://127.0.0.1:1"]) == 2
    assert "pip install 'distributed>=2024.1'" in capsys.readouterr().err
