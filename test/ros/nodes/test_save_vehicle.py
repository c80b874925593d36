"""Save the parameters that a flying MPC has estimated of its vehicle."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.presets import ideal

from quad_mpc_ros.analysis.identification.learned import learned, learned_file
from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

Start = Callable[..., "subprocess.Popen[bytes]"]


def flown(mpc: MpcConfig, *, thrust_scale: float, duration: float, **plant: Any) -> list[LoopStep]:
    simulator = ideal(thrust_scale=thrust_scale, duration=duration, **plant)
    return list(fly(mpc=mpc, simulator=simulator, reference=ReferenceConfig()))


def stats(steps: list[LoopStep]) -> list[TickStats]:
    return [step.tick.stats for step in steps if step.tick is not None]


def loaded(path: Path) -> MpcConfig:
    config = files.load([str(path)], [], schema={"mpc": MpcConfig})["mpc"]
    assert isinstance(config, MpcConfig)
    return config


@pytest.mark.parametrize("keep", ["mass", "curve"])
@pytest.mark.parametrize("thrust_scale", [0.7, 1.3])
def test_saved_vehicle_flies_as_modelled(thrust_scale: float, keep: Any, tmp_path: Path) -> None:
    lags = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}
    given = MpcConfig(**lags, input_delay=0.02)
    plant = {"rate_time_constant": 0.04, "thrust_time_constant": 0.04, "command_delay": 0.02}
    wrong = stats(flown(given, thrust_scale=thrust_scale, duration=6.0, **plant))

    found = learned(wrong[150:], given)
    path = tmp_path / "vehicle.yaml"
    path.write_text(learned_file(found, given, head="Learned.", keep=keep))
    saved = loaded(path)

    assert found.thrust_scale.value == pytest.approx(thrust_scale, abs=0.01)
    assert saved.rate_time_constant == pytest.approx(0.04, rel=0.05)
    assert saved.thrust_time_constant == pytest.approx(0.04, rel=0.1)
    assert saved.input_delay == 0.02  # of which it learns nothing
    kept = (saved.mass == given.mass, saved.thrust_curve == given.thrust_curve)
    assert kept == (keep == "mass", keep == "curve")

    again = stats(flown(saved, thrust_scale=thrust_scale, duration=3.0, **plant))
    assert unexplained(wrong) > 0.2
    assert unexplained(again) < 0.05


def unexplained(ticks: list[TickStats]) -> float:
    """Return the mean of what the estimator has to add to the modelled thrust."""
    return float(np.mean([abs(tick.thrust_scale - 1.0) for tick in ticks]))


TICK = TickStats(
    stamp_ns=0,
    source="mpc",
    reason="",
    solver_status="solved",
    iterations=10,
    primal_residual=0.0,
    dual_residual=0.0,
    solve_time_us=1.0,
    step_time_us=1.0,
    thrust_scale=0.8,
    odom_age_ms=1.0,
    reference_age_ms=1.0,
    commands=1,
    fallbacks=0,
    solver_failures=0,
    rejected_inputs=0,
)


@pytest.mark.parametrize(
    ("lags", "yaw", "saved"),
    [
        (0.03, 31.0, 0.04),
        (0.03, 110.0, (0.04, 0.04, 0.11)),
        ((0.02, 0.04, 0.1), 101.0, (0.02667, 0.05333, 0.101)),
    ],
)
def test_saves_lag_of_each_axis_once_identified(lags: Any, yaw: float, saved: Any) -> None:
    given = MpcConfig(rate_time_constant=lags)
    tick = dataclasses.replace(TICK, rate_time_constant_ms=40.0, yaw_time_constant_ms=yaw)
    text = learned_file(learned([tick] * 100, given), given, head="Learned.", keep="mass")
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert MpcConfig.build(parameters).rate_time_constant == pytest.approx(saved, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "learned_mean", "saved"),
    [
        (0.3, 0.45, 0.45),
        ((0.2, 0.3, 0.4), 0.6, (0.4, 0.6, 0.8)),
        (0.3, 0.304, 0.3),  # has not moved
        (0.0, 0.2, 0.2),
    ],
)
def test_saves_drag_once_identified(given: Any, learned_mean: float, saved: Any) -> None:
    config = MpcConfig(drag=given)
    tick = dataclasses.replace(TICK, drag=learned_mean)
    text = learned_file(learned([tick] * 100, config), config, head="Learned.", keep="mass")
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert MpcConfig.build(parameters).drag == pytest.approx(saved)
    wandering = [dataclasses.replace(TICK, drag=0.3 + 0.003 * k) for k in range(100)]
    assert learned(wandering, config).drag is None


REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "estimates nothing": ({"estimate_disturbance": False}, {}, "the MPC estimates nothing"),
    "the paper's": ({"formulation": "paper"}, {}, "given paper"),
    "does not fly": ({}, {"source": "hover", "reason": "solver: failed"}, "solver: failed"),
    "not yet": ({}, {"thrust_scale": 1.0}, "nothing has been learned yet"),
    "at the bound": ({}, {"thrust_scale": 0.5}, "at the end of what is estimated"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refuses_flight_without_information(case: str) -> None:
    parameters, changes, reason = REFUSED[case]
    ticks = [dataclasses.replace(TICK, **changes)] * 100
    assert learned([TICK] * 100, MpcConfig()).thrust_scale.value == pytest.approx(0.8)
    with pytest.raises(UserError, match=reason):
        learned(ticks, MpcConfig(**parameters))
    for remaining in 0.1, 0.3:  # half of it is left after 0.7 s
        scales = 0.7 + remaining * np.exp(-0.02 * np.arange(50))
        moving = [dataclasses.replace(TICK, thrust_scale=scale) for scale in scales]
        with pytest.raises(UserError, match="has not settled"):
            learned(moving, MpcConfig())


def test_saves_from_running_node_without_overwriting(
    start: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The namespace of the vehicle is that of its node, and of the figures it publishes.
    space = ("-r", "__ns:=/uav1")
    start("simulator", *space, "-p", "thrust_scale:=0.7", "-p", "drag:=0.3")
    start("reference", *space, "-p", "trajectory:=hover", "-p", "height:=1.5")
    start("mpc", *space, "-p", "drag:=0.3")
    out = tmp_path / "new" / "vehicle.yaml"
    # The first second of the flight is not yet settled; ask until it is.
    command = ["save-vehicle", "--node", "/uav1/mpc", "--duration", "1", "--out", str(out)]
    for _ in range(8):
        if main(command) == 0:
            break
    saved = loaded(out)
    a, b, c = (
        k / given for k, given in zip(saved.thrust_curve, MpcConfig().thrust_curve, strict=True)
    )
    assert a == pytest.approx(0.7, abs=0.02)
    assert (b, c) == pytest.approx((a, a), rel=1e-3)
    assert saved.mass == MpcConfig().mass
    # Kept, unless the first seconds, in which little thrust is known, moved it.
    assert saved.drag == pytest.approx(0.3, abs=0.05)
    assert list(out.parent.iterdir()) == [out]
    assert "Learned in flight by /uav1/mpc" in out.read_text()

    before = out.read_bytes()
    capsys.readouterr()
    assert main(command) == 2
    assert "is not overwritten" in capsys.readouterr().err
    assert out.read_bytes() == before

    assert main([*command[:-2]]) == 0
    assert yaml.safe_load(capsys.readouterr().out).keys() == {"/**"}


def test_missing_node_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("quad_mpc_ros.commands.running_mpc._ANSWER_TIMEOUT", 0.3)
    assert main(["save-vehicle", "--node", "ghost", "--out", str(tmp_path / "v.yaml")]) == 2
    assert "no node /ghost answers" in capsys.readouterr().err
    assert main(["save-vehicle", "--duration", "-1"]) == 2
    assert "--duration" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
