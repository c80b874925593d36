# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state of the ground in flights where MuJoCo says what the ground does.

What is right: with contact and the reference at rest on the ground ``on_ground``, and half a
second later at most. Without contact it flies, or is about to lift off or has just touched down;
never is it on the ground.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.touching import standing_config

from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.plants.mujoco.plant import MujocoPlant
from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.references.configured import joined_trajectory
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.path import Straight
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

pytestmark = pytest.mark.timeout(900)  # minutes are flown, and others may compute as well

NOISE = {"position_noise": 0.005, "attitude_noise": 0.005, "rate_noise": 0.02}
DECK = {
    "mujoco__deck__size": (3.0, 3.0),
    "mujoco__deck__position": (0.0, 0.0, 0.3),
    "mujoco__deck__heave_frequency": 0.2,
    "mujoco__deck__heave_amplitude": 0.2387,  # 0.3 m/s
    "mujoco__deck__heave_phase": 0.0,
    "mujoco__deck__roll_amplitude": math.radians(5.0),
    "mujoco__deck__pitch_amplitude": math.radians(5.0),
    "mujoco__deck__rock_frequency": 0.25,
    "initial_position": (0.0, 0.0, 0.35),
}
ON_GROUND, IN_AIR = {"on_ground"}, {"flying", "touching_down", "lifting_off", "unknown"}
Request = Callable[[LiveReference, int], Any]


class Moment(NamedTuple):
    """State at one odometry."""

    seconds: float
    touches: bool
    state: str
    mode: str
    throttle: float
    p_WB: Array
    tilt: float


def flown(
    duration: float,
    requests: dict[float, Request] | None = None,
    *,
    sinks: float = 0.0,
    mode: str = "on_request",
    **plant: Any,
) -> list[Moment]:
    """Return a flight on request, or one that ``sinks`` at a speed [m/s] through the ground."""
    simulator = standing_config(duration=duration, **plant)
    config = load_config("vehicles/paper")
    reference = config.reference.updated({"mode": mode, "takeoff_height": 1.2})
    body, controller = MujocoPlant(simulator), warmed_up(config.mpc)
    trajectory = joined_trajectory(reference)
    if sinks:
        path = Straight(body.state.p_WB, v_WB_W=np.array([0.0, 0.0, -sinks]))
        trajectory = FlatTrajectory(path, reference, yaw=0.0)
    live = LiveReference(reference, trajectory, joined=lambda: joined_trajectory(reference))
    stream = OdometryStream(body, simulator, start_stamp_ns=SIMULATION_START_NS)
    left, moments = dict(requests or {}), []
    while (sent := stream.step()) is not None:
        now_ns = sent.odometry.stamp_ns
        seconds = 1e-9 * (now_ns - SIMULATION_START_NS)
        live.observe(sent.odometry)
        for time in [time for time in left if seconds >= time]:
            assert left.pop(time)(live, now_ns).accepted
        window = live.window(now_ns)
        assert window is not None
        tick = controller.step(sent.odometry, window)
        assert tick is not None
        assert tick.command is not None
        live.set_ground_state(controller.ground_state)
        body.apply(tick.command)
        moments.append(
            Moment(
                seconds=seconds,
                touches=bool(body.scene.touched()),
                state=tick.stats.ground,
                mode=live.mode(now_ns),
                throttle=tick.command.throttle,
                p_WB=sent.truth.p_WB,
                tilt=math.acos(min(sent.truth.up, 1.0)),
            )
        )
    return moments


def share(moments: list[Moment], states: set[str]) -> float:
    return float(np.mean([moment.state in states for moment in moments]))


def in_air(moments: list[Moment]) -> list[Moment]:
    """Those without contact since a tenth of a second: feet that leave may come back at once."""
    apart, found = 0, []
    for moment in moments:
        apart = 0 if moment.touches else apart + 1
        if apart > 5:
            found.append(moment)
    return found


def landed_after(moments: list[Moment], since: float) -> float:
    """How long after its first contact from a time on it is on the ground for good [s]."""
    met = next(each.seconds for each in moments if each.seconds >= since and each.touches)
    off = [each.seconds for each in moments if each.state != "on_ground"]
    return max(off) - met


TAKE_OFF, LAND = LiveReference.take_off, LiveReference.land


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_stays_on_a_rocking_and_heaving_deck(noise: float) -> None:
    moments = flown(20.0, velocity_noise=noise, **NOISE, **DECK)
    later = [moment for moment in moments if moment.seconds > 1.0]
    assert share(later, ON_GROUND) >= 0.99
    assert {moment.throttle for moment in later} == {0.0}


@functools.cache
def to_and_from(case: str) -> list[Moment]:
    return flown(17.0, {2.0: TAKE_OFF, 7.0: LAND}, **NOISE, velocity_noise=0.05, **CASES[case])


CASES: dict[str, dict[str, Any]] = {
    "level": {},
    "ground effect": {"airframe__ground_effect": 1.0},
    "slope": {"mujoco__ground__slope": math.radians(10.0)},
    "deck": DECK,
    "strong": {"thrust_scale": 1.3},
    "weak": {"thrust_scale": 0.75},
}


@pytest.mark.parametrize("case", CASES)
def test_lift_off_flight_and_touchdown(case: str) -> None:
    moments = to_and_from(case)
    assert share(in_air(moments), IN_AIR) == 1.0
    flies = [each for each in in_air(moments) if each.mode not in ("takeoff", "landing")]
    assert share(flies, {"flying"}) >= 0.99
    before = [moment for moment in moments if 1.0 < moment.seconds < 2.0]
    assert share(before, ON_GROUND) == 1.0
    assert landed_after(moments, 8.0) < 3.0
    right = [
        moment.state == "on_ground" if moment.mode == "ground" else moment.state in IN_AIR
        for moment in moments
        if moment.seconds > 1.0
    ]
    assert np.mean(right) >= 0.99


def test_takes_off_level_and_vertically_from_a_slope() -> None:
    """Its thrust leans as the slope does until it has turned, and pushes it downhill meanwhile."""
    leaving = [moment for moment in to_and_from("slope") if 2.0 <= moment.seconds < 5.0]
    flown_from = next(moment for moment in leaving if moment.state == "flying")
    assert flown_from.tilt < math.radians(5.0)
    assert max(moment.tilt for moment in leaving) < math.radians(11.0)
    places = np.array([moment.p_WB[:2] for moment in leaving])
    assert np.linalg.norm(places - places[0], axis=1).max() < 0.15


@pytest.mark.parametrize("slope", [0.0, math.radians(10.0)])
def test_a_touchdown_at_one_and_a_half_metres_a_second(slope: float) -> None:
    moments = flown(
        8.0,
        sinks=1.5,
        mode="at_once",
        initial_position=(0.0, 0.0, 1.5),
        initial_velocity=(0.0, 0.0, -1.5),
        initial_throttle=0.2923,
        mujoco__ground__slope=slope,
    )
    assert share(in_air(moments), IN_AIR) == 1.0
    assert landed_after(moments, 0.0) < 1.0


def low(live: LiveReference, now_ns: int) -> Any:
    return live.go_to(
        now_ns,
        frame_id="odom",
        p_WB=np.array([0.0, 0.0, 0.02]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
    )


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_flight_two_centimetres_above_the_ground_is_flight(noise: float) -> None:
    moments = flown(
        30.0,
        {1.0: TAKE_OFF, 8.0: low},
        velocity_noise=noise,
        airframe__ground_effect=1.0,
        position_noise=0.1 * noise,
    )
    above = [moment for moment in moments if moment.seconds > 15.0]
    assert abs(np.mean([moment.p_WB[2] for moment in above]) - 0.02) < 0.01
    assert share(above, {"flying"}) >= 0.99
    assert share(moments[200:], ON_GROUND) == 0.0


@pytest.mark.parametrize("landed", [None, True])
def test_vehicle_carried_by_hand_never_counts_as_flying(landed: bool | None) -> None:
    """Waved about at up to 3 m/s and put down a storey higher, then engaged."""
    config = load_config("vehicles/paper")
    live = LiveReference(
        config.reference.updated({"mode": "on_request"}),
        joined_trajectory(config.reference),
        joined=lambda: joined_trajectory(config.reference),
    )
    controller, rng = Controller(config.mpc), np.random.default_rng(3)
    controller.engage(False)
    controller.landed(landed)
    live.engage(False)
    live.landed(landed)
    states, throttles, place = [], [], np.zeros(3)
    for k in range(1500):
        seconds, now_ns = 0.02 * k, SIMULATION_START_NS + 20_000_000 * k
        carried = 2.0 < seconds < 20.0
        goal = np.array([5.0 * math.sin(0.5 * seconds), 2.0, 3.0 + math.sin(3.0 * seconds)])
        velocity = np.clip(2.0 * (goal - place), -3.0, 3.0) if carried else np.zeros(3)
        place = place + 0.02 * velocity
        R_WB = so3.exp([0.8 * math.sin(2.0 * seconds) * carried, 0.0, seconds * carried])
        odometry = OdometrySample(
            stamp_ns=now_ns,
            p_WB=place + 0.005 * rng.normal(size=3),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=R_WB.T @ velocity + 0.05 * rng.normal(size=3),
            w_WB_B=np.zeros(3),
        )
        if k == 1250:
            controller.engage(True)
            live.landed(True)
            live.engage(True)
        live.observe(odometry)
        window = live.window(now_ns)
        assert window is not None
        tick = controller.step(odometry, window)
        assert tick is not None
        assert tick.command is not None
        live.set_ground_state(controller.ground_state)
        states.append(tick.stats.ground)
        throttles.append(tick.command.throttle)
    assert set(states[1:1250]) == {"unknown" if landed is None else "on_ground"}
    assert set(states[1250:]) <= {"unknown", "on_ground"}
    assert set(states[1285:]) == ON_GROUND
    assert set(throttles[1251:]) == {0.0}
