"""A real Dask cluster on this machine; scheduler, workers and client are its processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from fixtures.campaigns import CONTENT, HereAndNow, flown_into, lines_in, start, wait_until

from quad_mpc_ros.cli import main
from quad_mpc_ros.extras.campaigns.table import CSV_NAME

pytest.importorskip("distributed")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a scheduler and two workers; return the address and the workers."""
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-P", "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    started = [subprocess.Popen([*scheduler, "--scheduler-file", str(file)], **quiet)]
    try:
        wait_until(file.exists)
        worker = [*dask, "worker", "--scheduler-file", str(file), "--nthreads", "1"]
        worker += ["--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
        started += workers
        address = json.loads(file.read_text())["address"]
        wait_until(lambda: _count(address) == 2)
        yield address, workers
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def _count(address: str) -> int:
    from distributed import Client

    with Client(address, timeout=20, set_as_default=False) as client:
        return len(client.nthreads())


def test_cluster_writes_the_same_bytes_after_a_worker_and_the_client_died(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, workers = cluster
    content = {**CONTENT, "flights": 60}
    file, out = tmp_path / "file.yaml", tmp_path / "out"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    client = start(str(file), "--out", str(out), "--scheduler", address)
    journal = out / "journal.jsonl"
    try:
        wait_until(lambda: lines_in(journal) > 6)
        os.kill(workers[0].pid, signal.SIGKILL)
        before = lines_in(journal)
        wait_until(lambda: lines_in(journal) > before + 6)
    finally:
        client.kill()
        client.wait()
    assert not (out / CSV_NAME).exists()
    kept = lines_in(journal)

    assert main(["campaign", "--resume", str(out), "--scheduler", address]) == 0
    numbers = [json.loads(line)["flight"] for line in journal.read_text().splitlines()[1:]]
    assert kept < 61
    assert sorted(numbers) == list(range(60))
    whole = flown_into(tmp_path / "whole", HereAndNow(), content)
    for name in ("flights.csv", "flights.parquet"):
        if (whole / name).exists():
            assert (out / name).read_bytes() == (whole / name).read_bytes()
