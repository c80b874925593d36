"""From the ground and back to it: the simulated vehicle with controller and live reference."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.director import Reply
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

Requests = dict[float, Callable[[LiveReference, int], Reply]]

LAGS = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}


def flown(
    requests: Requests, *, duration: float, simulator: dict[str, object], **reference: object
) -> tuple[LiveReference, Array, Array]:
    """Return the reference, and true heights and throttles commanded over the odometries."""
    config = ReferenceConfig.build(reference)
    make = configured_trajectory if config.mode == "at_once" else joined_trajectory
    live = LiveReference(config, make(config), joined=lambda: joined_trajectory(config))
    plant_config = SimulatorConfig.build({**LAGS, "duration": duration, **simulator})
    plant, controller = make_plant(plant_config), warmed_up(MpcConfig.build(LAGS))
    stream = OdometryStream(plant, plant_config, start_stamp_ns=SIMULATION_START_NS)
    waiting, heights, throttles = dict(requests), [], []
    while (sent := stream.step()) is not None:
        now_ns = sent.odometry.stamp_ns
        live.observe(sent.odometry)
        for time in [t for t in waiting if now_ns >= SIMULATION_START_NS + round(1e9 * t)]:
            assert waiting.pop(time)(live, now_ns).accepted
        window = live.window(now_ns)
        assert window is not None
        controller.receive_reference(window, now_ns=now_ns)
        tick = controller.receive_odometry(sent.odometry, now_ns=now_ns)
        assert tick is not None
        assert tick.command is not None
        live.set_ground_state(controller.ground_state)
        plant.apply(tick.command)
        heights.append(sent.truth.p_WB[2])
        throttles.append(tick.command.throttle)
    return live, np.array(heights), np.array(throttles)


@pytest.mark.parametrize("error", [-0.3, 0.0, 0.3])
def test_finds_the_ground(error: float) -> None:
    """The odometry is wrong about the height by then, and so the ground is not at its zero."""
    live, heights, throttles = flown(
        {0.5: LiveReference.land},
        duration=8.5,
        simulator={"position_bias": [0, 0, error], "initial_position": [0, 0, 1.0 - error]},
        trajectory="hover",
        height=1.0,
    )
    assert live.mode(SIMULATION_START_NS + 8_500_000_000) == "ground"
    assert heights[-1] == 0.0
    assert throttles[-20:].max() < 0.02
    touched = int(np.flatnonzero(heights == 0.0)[0])
    assert (heights[touched:] == 0.0).all()
    speed = (heights[touched - 3] - heights[touched - 1]) * 25.0
    assert speed == pytest.approx(0.3, abs=0.1)


def test_a_noisy_heavier_vehicle_takes_off_lands_and_takes_off_again() -> None:
    take_off, land = LiveReference.take_off, LiveReference.land
    _, heights, throttles = flown(
        {0.5: take_off, 5.0: land, 11.0: take_off},
        duration=15.5,
        simulator={
            "mass_scale": 1.2,
            "position_noise": 0.01,
            "velocity_noise": 0.05,
            "wind": [2.0, 0.0, 0.0],
        },
        mode="on_request",
        takeoff_height=1.0,
    )
    assert throttles[:25].max() < 0.1
    assert heights[240] == pytest.approx(1.0, abs=0.1)
    assert heights[540] == 0.0
    assert throttles[500:550].max() < 0.02
    assert heights[-1] == pytest.approx(1.0, abs=0.1)
    # The thrust ramps up: from nothing to lifting off it takes its time.
    begun = int(np.flatnonzero(throttles > 0.02)[0])
    lifted = int(np.flatnonzero(heights > 0.0)[0])
    assert lifted - begun >= 5
    assert heights[:240].max() < 1.15
