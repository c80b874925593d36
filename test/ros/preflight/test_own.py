# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a node finds in its own parameters, and logs when it is configured."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.ros.preflight import own
from quad_mpc_ros.ros.preflight.own import bag_place, own_findings


@pytest.mark.parametrize("preset", files.presets())
def test_shipped_configurations_warn_only_of_lags(preset: str) -> None:
    try:
        nodes = files.load([preset], [], schema=SCHEMA)
    except UserError:  # of another node, or its plant is not installed
        return
    found = [each.text for config in nodes.values() for each in own_findings(config)]
    mpc = nodes["mpc"]
    assert isinstance(mpc, MpcConfig)
    assert len(found) == bool(mpc.unmodelled_lags)
    assert all("every real vehicle lags" in text for text in found)


def test_lags_do_not_matter_in_lockstep() -> None:
    assert own_findings(MpcConfig(input_delay=0.0))
    assert not own_findings(MpcConfig(input_delay=0.0, lockstep=True))


@pytest.mark.parametrize("directory", ["", "bag", "not/yet/there/bag"])
def test_free_space_is_measured_on_the_disk_of_the_bag(
    directory: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert bag_place(RecorderConfig(directory=directory)) == tmp_path
    elsewhere = tmp_path / "disk"
    elsewhere.mkdir()
    assert bag_place(RecorderConfig(directory=str(elsewhere / "bag"))) == elsewhere


def test_recorder_warns_of_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own, "free_bytes", lambda place: 20_000_000)
    config = RecorderConfig(directory=str(tmp_path / "bag"))
    (found,) = own_findings(config)
    assert f"20 MB free for the bag in {tmp_path}" in found.text
    monkeypatch.setattr(own, "free_bytes", lambda place: 10**10)
    assert not own_findings(config)
