# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Margins of a rehearsal by bisection, the verdict on them, and vehicles that crash."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from fixtures.engines import InThisProcess

from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.campaigns import rehearsal
from quad_mpc_ros.extras.campaigns.rehearsal import (
    Direction,
    Limit,
    Lost,
    Rehearsal,
    directions_of,
    limit_of,
    rehearse,
    verdict_on,
)
from quad_mpc_ros.simulation.config import SimulatorConfig

DELAY = next(each for each in directions_of(SimulatorConfig()) if each.name == "delay is longer")


LOST = Lost(number=0, reason="it fell", parameter_file="")


def limit(direction: Direction, tolerated: float) -> Limit:
    """Return the limit of a vehicle that crashes beyond a deviation."""
    return limit_of(direction, lambda by: [LOST] if by > tolerated else [])


@pytest.mark.parametrize("tolerated", [0.0, 0.001, 0.02, 0.0999, 0.17])
def test_the_margin_is_just_below_the_limit(tolerated: float) -> None:
    found = limit(DELAY, tolerated)
    assert found.margin <= tolerated < found.margin + DELAY.most / 2**5
    assert found.lost is LOST


def test_stops_the_search_at_the_largest_disturbance() -> None:
    found = limit(DELAY, 1.0)
    assert (found.margin, found.lost) == (DELAY.most, None)
    assert found.text == "200 ms or more"


@pytest.mark.parametrize(
    ("tolerated", "word"), [(0.2, "ready"), (0.03, "marginal"), (0.002, "not ready")]
)
def test_the_verdict_follows_the_smallest_margin(tolerated: float, word: str) -> None:
    others = [limit(each, 1.0) for each in directions_of(SimulatorConfig())]
    found = Rehearsal(lost=[], limits=[*others, limit(DELAY, tolerated)])
    verdict = verdict_on(found)
    assert verdict.word == word
    if word != "ready":
        assert "delay is longer: margin" in verdict.reasons[0]
        assert "identify" in verdict.advice[0]


def test_is_not_ready_if_the_configured_vehicle_crashes() -> None:
    verdict = verdict_on(Rehearsal(lost=[LOST], limits=[]))
    assert verdict.word == "not ready"
    assert "1 of 6 disturbed vehicles did not recover: vehicle 0: it fell" in verdict.reasons[0]


def test_omits_the_lags_of_a_plant_that_has_its_own() -> None:
    own = {each.parameter for each in directions_of(SimulatorConfig(plant="rotors"))}
    assert own == {"command_delay", "thrust_scale", "mass_scale"}


def test_a_scale_and_a_lag_per_axis_are_changed() -> None:
    lag, *_, mass = directions_of(SimulatorConfig())
    assert lag.changed((0.02, 0.02, 0.05), 0.01) == pytest.approx([0.03, 0.03, 0.06])
    assert mass.changed(1.1, 0.5) == pytest.approx(1.65)


def test_agile_crashes_with_an_unmodelled_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The weights of agile do not tolerate 60 ms more delay than modelled."""
    monkeypatch.setattr(rehearsal, "_BISECTION_STEPS", 0)
    monkeypatch.setattr(
        rehearsal, "directions_of", lambda _: [dataclasses.replace(DELAY, most=0.06)]
    )
    found = rehearse(["agile"], ["mpc.omega_max=[6,6,3]"], InThisProcess(), lambda _: None)
    assert found.lost == []
    (delay,) = found.limits
    assert delay.lost is not None


def test_rejects_a_parameter_that_the_rehearsal_varies() -> None:
    with pytest.raises(UserError, match=r"simulator\.seed: also set"):
        rehearse(["default"], ["simulator.seed=3"], InThisProcess(), lambda _: None)


def test_a_vehicle_that_lags_far_more_than_configured_is_not_ready(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the disturbances this vehicle hovers exactly."""
    lags = ["simulator.rate_time_constant=0.25", "simulator.command_delay=0.2"]
    arguments = [part for lag in lags for part in ("--set", lag)]
    out = tmp_path / "out"
    assert main(["rehearse", *arguments, "--workers", "1", "--out", str(out)]) == 1
    printed = capsys.readouterr().out
    assert "verdict  not ready" in printed
    assert "did not recover" in printed
    assert (out / "lost" / "as_guessed.yaml").is_file()
    assert main(["rehearse", "--set", "mpc.mas=1", "--out", str(tmp_path / "bad")]) == 2
