# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The closed loop on the ground and back to it, with odometry as noisy as estimators make it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import make_plant
from quad_mpc_ros.simulation.sensors import OdometryStream

LAGS: dict[str, Any] = {"rate_time_constant": 0.04, "thrust_time_constant": 0.04}
ROBUST = agile(**LAGS, input_delay=0.03, horizon_steps=20, R=(0.0, 0.1, 0.1, 0.1))
NOISE: dict[str, Any] = {"position_noise": 0.005, "attitude_noise": 0.005, "rate_noise": 0.02}
SECOND = 1_000_000_000


class Moment(NamedTuple):
    """State at one odometry of a flight on request."""

    seconds: float
    truth: OdometrySample
    throttle: float
    w_WB_B: Array
    ground: str
    thrust_scale: float
    a_W: Array


def on_request(*, duration: float, requests: dict[float, str], **plant: Any) -> list[Moment]:
    """Return the states of a flight from the ground on request."""
    simulator = ideal(duration=duration, command_delay=0.03, **LAGS, **NOISE, **plant)
    config = ReferenceConfig(trajectory="hover", mode="on_request", takeoff_height=1.5)
    trajectory = configured_trajectory(config)
    live = LiveReference(config, trajectory, joined=lambda: trajectory)
    body, controller = make_plant(simulator), warmed_up(ROBUST)
    stream = OdometryStream(body, simulator, start_stamp_ns=SECOND)
    left, moments = dict(requests), []
    while (sent := stream.step()) is not None:
        now_ns = sent.odometry.stamp_ns
        seconds = 1e-9 * (now_ns - SECOND)
        live.observe(sent.odometry)
        for time in [time for time in left if seconds >= time]:
            reply = getattr(live, left.pop(time))(now_ns)
            assert reply.accepted, reply.text
        window = live.window(now_ns)
        assert window is not None
        tick = controller.step(sent.odometry, window)
        assert tick is not None
        assert tick.command is not None
        live.set_ground_state(controller.ground_state)
        body.apply(tick.command)
        stats = tick.stats
        moments.append(
            Moment(
                seconds=seconds,
                truth=sent.truth,
                throttle=tick.command.throttle,
                w_WB_B=tick.command.w_WB_B,
                ground=stats.ground,
                thrust_scale=stats.thrust_scale,
                a_W=np.array([stats.disturbance_x, stats.disturbance_y, stats.disturbance_z]),
            )
        )
    return moments


@pytest.mark.parametrize(("scale", "noise"), [(1.0, 0.2), (0.7, 0.05), (1.3, 0.1)])
def test_takes_off_lands_and_keeps_the_estimate(scale: float, noise: float) -> None:
    moments = on_request(
        duration=18.0,
        requests={2.0: "take_off", 10.0: "land"},
        thrust_scale=scale,
        velocity_noise=noise,
    )
    above = [moment.truth.p_WB[2] for moment in moments if 7.0 < moment.seconds < 10.0]
    assert np.abs(np.array(above) - 1.5).max() < 0.35
    up = [moment for moment in moments if moment.truth.p_WB[2] > 0.3]
    assert {moment.ground for moment in up} == {"flying"}
    end = [moment for moment in moments if moment.seconds > 16.5]
    assert {moment.ground for moment in end} == {"on_ground"}
    assert {moment.throttle for moment in end} == {0.0}
    assert not np.any([moment.w_WB_B for moment in end])
    assert end[-1].truth.up == pytest.approx(1.0)
    assert end[-1].truth.p_WB[2] == 0.0
    hovering = [moment for moment in moments if 8.0 < moment.seconds < 10.0]
    # What lifted it in flight would lift it again.
    lifts = [moment.thrust_scale + moment.a_W[2] / 9.81 for moment in hovering]
    again = end[-1].thrust_scale + end[-1].a_W[2] / 9.81
    assert min(lifts) - 0.05 < again < max(lifts) + 0.05


@pytest.mark.parametrize("seed", range(2))
def test_lost_reference_on_ground_causes_no_lift_off(seed: int) -> None:
    rng = np.random.default_rng(seed)
    controller = Controller(ROBUST)
    throttles, sources = [], []
    for k in range(400):
        stamp_ns = SECOND + 20_000_000 * k
        odometry = OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=0.01 * rng.normal(size=3),
            q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
            v_WB_B=0.2 * rng.normal(size=3),
            w_WB_B=np.zeros(3),
        )
        if k < 100:
            window = ReferenceWindow.hover([0.0, 0.0, -0.5], stamp_ns=stamp_ns)
            controller.receive_reference(window, now_ns=stamp_ns)
        tick = controller.receive_odometry(odometry, now_ns=stamp_ns)
        assert tick is not None
        assert tick.command is not None
        throttles.append(tick.command.throttle)
        sources.append(tick.stats.source)
    # Until it is known to stand noise may raise the thrust for a moment, far from the weight.
    assert max(throttles) < 0.5 * ROBUST.vehicle().hover_throttle
    assert max(throttles[50:]) < 0.02
    assert set(sources[200:]) == {"idle"}


def flown(reference: ReferenceConfig, **plant: Any) -> list[LoopStep]:
    simulator = ideal(command_delay=0.03, **LAGS, **plant)
    mpc = agile(**LAGS, input_delay=0.03)
    return list(fly(mpc=mpc, simulator=simulator, reference=reference, on_reference=True))


@pytest.mark.parametrize("scale", [0.6, 1.5])
@pytest.mark.parametrize("trajectory", ["hover", "flip"])
def test_never_detects_ground_contact_in_flight(trajectory: str, scale: float) -> None:
    """Upside down at the top of a flip the throttle is at its least, and nothing moves."""
    reference = ReferenceConfig(trajectory=trajectory, height=6.0, **_limits(trajectory))
    steps = flown(
        reference,
        duration=6.0,
        thrust_scale=scale,
        velocity_noise=0.4,
        position_noise=0.02,
        wind=(2.0, 0.0, 1.0),
        gust_intensity=2.0,
        seed=4,
    )
    said = [
        step.tick.stats.ground
        for step in steps
        if step.tick is not None and step.truth.p_WB[2] > 0.05
    ]
    assert "on_ground" not in said
    assert "flying" in said


def _limits(trajectory: str) -> dict[str, Any]:
    return {} if trajectory == "hover" else {"time_scaling": "auto"}
