# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of what is identified: a short one is made, of a vehicle whose drag is the body's."""

from __future__ import annotations

from types import ModuleType

import pytest
from fixtures.scripts import script_module


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return script_module("bench/identified.py")


def test_identified_vehicle_is_flown_with_the_result(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(script, "DURATION", 8.0)
    monkeypatch.setattr(script, "FASTEST", (9.0, 1.5))
    assert script.main(["paper", "--seeds", "1", "--set", "simulator.velocity_noise=0.02"]) == 0
    heading, *lines, flight, _ = capsys.readouterr().out.splitlines()
    assert heading.startswith("paper ")
    names = [line[2:25].strip() for line in lines]
    assert {"thrust per mass", "rates' lag x", "delay", "drag x"} <= set(names)
    assert flight.startswith("  lemniscate at 1.5 rad/s: RMSE 0.")
