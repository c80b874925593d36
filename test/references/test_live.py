# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference of a live flight: requests, refusals, and continuity."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.interleaving import interleaved, traced
from numpy.testing import assert_allclose

from quad_mpc_ros.control.estimation.ground_state import GroundState, idles
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.references import live as live_module
from quad_mpc_ros.references import timeline
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.director import Reply
from quad_mpc_ros.references.feasibility import needs_of
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.references.trajectory import TrajectorySamples
from quad_mpc_ros.references.velocity import VelocityCommand

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def odometry(stamp_ns: int, *p_WB: float, frame_id: str = "odom") -> OdometrySample:
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=np.array(p_WB or (0.0, 0.0, 0.0)),
        q_WB_xyzw=LEVEL,
        v_WB_B=np.zeros(3),
        w_WB_B=np.zeros(3),
        frame_id=frame_id,
    )


def live(**changes: object) -> LiveReference:
    config = ReferenceConfig.build({"mode": "on_request", **changes})
    if config.mode == "on_request":
        return LiveReference(
            config, joined_trajectory(config), joined=lambda: joined_trajectory(config)
        )
    return LiveReference(
        config, configured_trajectory(config), joined=lambda: joined_trajectory(config)
    )


def hovering(**changes: object) -> tuple[LiveReference, int]:
    """Return a reference that holds, and the time."""
    reference = live(**changes)
    reference.observe(odometry(START))
    assert reference.take_off(START).accepted
    now = START + 10 * SECOND
    assert reference.mode(now) == "hold"
    return reference, now


def message(
    p_WB: object, seconds: object, *, frame_id: str = "odom", q_WB_xyzw: Array | None = None
) -> ReferenceWindow:
    points = np.reshape(np.array(p_WB, dtype=float), (-1, 3))
    rest = np.zeros_like(points)
    return ReferenceWindow(
        stamp_ns=0,
        frame_id=frame_id,
        offset_ns=np.round(1e9 * np.array(seconds, dtype=float)).astype(np.int64),
        p_WB=points,
        q_WB_xyzw=np.tile(LEVEL, (len(points), 1)) if q_WB_xyzw is None else q_WB_xyzw,
        v_WB_W=rest,
        a_WB_W=rest,
        w_WB_W=rest,
    )


def place(reference: LiveReference, now_ns: int) -> Array:
    window = reference.window(now_ns)
    assert window is not None
    return window.p_WB[0]


def same_window(one: ReferenceWindow | None, other: ReferenceWindow | None) -> bool:
    if one is None or other is None:
        return one is other
    fields = ("offset_ns", "p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")
    return all(np.array_equal(getattr(one, each), getattr(other, each)) for each in fields)


def assert_same_windows(one: ReferenceWindow | None, other: ReferenceWindow | None) -> None:
    assert one is not None and same_window(one, other)


@pytest.mark.parametrize("trajectory", ["square", "lemniscate"])
def test_at_once_is_unchanged_until_a_request_is_accepted(trajectory: str) -> None:
    reference = live(mode="at_once", trajectory=trajectory)
    server = ReferenceServer(ReferenceConfig.build({"trajectory": trajectory}))
    assert_same_windows(reference.window(START - 1), server.window(START - 1))
    reference.observe(odometry(START))
    server.start(START)
    now = START + 3 * SECOND
    assert not reference.take_off(now).accepted
    for step in range(20):
        time = now + step * SECOND // 3
        assert_same_windows(reference.window(time), server.window(time))


def test_a_flight_begun_at_once_can_be_held_and_landed() -> None:
    reference = live(mode="at_once", trajectory="circle")
    reference.observe(odometry(START))
    now = START + 3 * SECOND
    before = reference.window(now)
    assert reference.hold(now).accepted
    after = reference.window(now)
    assert before is not None
    assert after is not None
    assert_allclose(after.p_WB[0], before.p_WB[0], atol=1e-9)
    assert_allclose(after.v_WB_W[0], before.v_WB_W[0], atol=1e-9)
    assert reference.mode(now + 5 * SECOND) == "hold"
    assert reference.land(now + 5 * SECOND).accepted


def test_refuses_requests_before_odometry() -> None:
    reference = live()
    assert reference.window(START) is None
    for answer in (reference.take_off(START), reference.land(START)):
        assert answer.text == "no usable odometry yet"
    reference.observe(odometry(START, 1.0, 2.0, 0.5))
    assert place(reference, START)[:2].tolist() == [1.0, 2.0]
    window = reference.window(START)
    assert window is not None and idles(window, 9.81)


def test_on_request_the_square_does_not_jump() -> None:
    trajectory = joined_trajectory(ReferenceConfig())
    period = trajectory.period_ns
    assert trajectory.smooth
    assert trajectory.jumps(0, 2 * period) == []
    times = list(range(0, period, SECOND // 100))
    steps = np.diff(trajectory.at(times).p_WB, axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.03
    corners = np.array([[0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]], dtype=float)
    distances = np.linalg.norm(trajectory.at(times).p_WB[:, None] - corners, axis=2)
    assert distances.min(axis=0).max() < 1e-6
    assert_allclose(trajectory.at([period + 7]).p_WB, trajectory.at([7]).p_WB, atol=1e-9)


def test_a_goal_of_two_dimensions_keeps_the_height() -> None:
    reference, now = hovering()
    heading = np.array([0.0, 0.0, math.sin(0.5), math.cos(0.5)])
    goal = np.array([3.0, -2.0, 0.0])
    assert reference.go_to(now, frame_id="odom", p_WB=goal, q_WB_xyzw=heading).accepted
    window = reference.window(now + 10 * SECOND)
    assert window is not None
    assert_allclose(window.p_WB[0], [3.0, -2.0, 1.5], atol=1e-6)
    assert_allclose(window.q_WB_xyzw[0], heading, atol=1e-6)
    # Asked for while it climbs or descends: where that leads, or the height of a take-off.
    reference = live()
    reference.observe(odometry(START))
    reference.take_off(START)
    reference.go_to(START + SECOND, frame_id="odom", p_WB=goal, q_WB_xyzw=heading)
    assert place(reference, START + 15 * SECOND)[2] == pytest.approx(1.5)
    reference.land(START + 15 * SECOND)
    reference.go_to(START + 18 * SECOND, frame_id="odom", p_WB=goal, q_WB_xyzw=heading)
    assert place(reference, START + 30 * SECOND)[2] == pytest.approx(1.5)


SPAN = np.arange(0.0, 8.0, 0.1)
RING = np.column_stack((np.cos(SPAN), np.sin(SPAN), 2.0 + 0.0 * SPAN))


def goal(*p_WB: float, frame_id: str = "odom", q: object = LEVEL) -> Callable[..., Reply]:
    return lambda reference, now: reference.go_to(
        now, frame_id=frame_id, p_WB=np.array(p_WB), q_WB_xyzw=np.array(q)
    )


def course(*arguments: object, **options: object) -> Callable[..., Reply]:
    return lambda reference, now: reference.follow(now, message(*arguments, **options))


BAD = {
    "no point": (course([], []), "0 points, expected 2"),
    "one point": (course([1, 1, 2], [0]), "1 points, expected 2"),
    "too many points": (course(np.ones((1001, 3)), np.arange(1001)), "expected 2 to 1000"),
    "times backwards": (course([0, 0, 2, 1, 0, 2, 2, 0, 2], [0, 2, 1]), "time of point 2"),
    "times the same": (course([0, 0, 2, 1, 0, 2], [1, 1]), "time of point 1"),
    "NaN in a point": (course([0, 0, 2, 1, math.nan, 2], [0, 3]), "not finite"),
    "frame": (course([0, 0, 2, 1, 0, 2], [0, 3], frame_id="map"), "frame 'map', expected 'odom'"),
    "no attitude": (
        course([0, 0, 2, 1, 0, 2], [0, 3], q_WB_xyzw=np.zeros((2, 4))),
        "quaternion",
    ),
    "too fast": (course([0, 0, 2, 9, 0, 2], [0, 0.5]), "beyond the limit"),
    "for hours": (course([0, 0, 2, 9, 0, 2], [0, 1e6]), "at most 600"),
    "points below ground": (course([0, 0, 2, 1, 0, -2], [0, 3]), "height"),
    "many below ground": (course(RING - [0, 0, 3], SPAN), "height"),
    "points too far": (course([0, 0, 2, 101, 0, 2], [0, 100]), "beyond reach"),
    "goal below ground": (goal(0, 0, -0.5), "0.5 m below the ground"),
    "goal too far": (goal(99, 99, 2), "beyond reach, 100 m"),
    "goal NaN": (goal(math.nan, 0, 2), "not finite"),
    "goal infinite": (goal(math.inf, 0, 2), "not finite"),
    "goal frame": (goal(1, 0, 2, frame_id="map"), "frame 'map', expected 'odom'"),
    "goal without frame": (goal(1, 0, 2, frame_id=""), "frame ''"),
    "goal without attitude": (goal(1, 0, 2, q=[0, 0, 0, 0]), "quaternion"),
    "goal attitude NaN": (goal(1, 0, 2, q=[0, 0, 0, math.nan]), "not finite"),
    "take-off": (lambda reference, now: reference.take_off(now), "take-off is rejected in"),
}


@pytest.mark.parametrize("case", BAD)
def test_refuses_infeasible_request_and_continues(case: str) -> None:
    request, reason = BAD[case]
    reference, now = hovering(trajectory="circle")
    assert reference.start(now).accepted
    for wait in (SECOND, 8 * SECOND):  # on the way there, and on the circle
        now += wait
        before = reference.window(now)
        answer = request(reference, now)
        assert not answer.accepted
        assert reason in answer.text
        assert_same_windows(reference.window(now), before)
        assert reference.mode(now + 20 * SECOND) == "tracking"


@pytest.mark.parametrize(
    ("p_WB", "seconds"),
    [(RING, SPAN), ([1, 0, 2, 3, 0, 2, 3, 2, 3], [0, 3, 6])],
    ids=["many", "few"],
)
def test_a_received_trajectory_is_flown_through_its_points(p_WB: object, seconds: object) -> None:
    reference, now = hovering(max_acceleration=4.0)
    sent = message(p_WB, seconds)
    assert reference.follow(now, sent).accepted
    while reference.mode(now) != "tracking":
        now += SECOND // 100
    flown = np.array([place(reference, now + k * SECOND // 50) for k in range(600)])
    distance = np.linalg.norm(flown[:, None] - sent.p_WB, axis=2).min(axis=0)
    assert distance.max() < 0.05
    assert_allclose(flown[-1], sent.p_WB[-1], atol=0.6)  # a moving end is followed by a stop


def test_drawn_path_runs_from_now_to_the_end() -> None:
    reference, now = hovering()
    assert goal(3.0, 0.0, 2.5)(reference, now).accepted
    drawn = reference.planned_samples(now).p_WB
    assert_allclose(drawn[0], place(reference, now), atol=1e-9)
    assert_allclose(drawn[-1], [3.0, 0.0, 2.5], atol=1e-6)
    assert reference.start(now).accepted
    assert 100 < len(reference.planned_samples(now).p_WB) <= 502


def moving(stamp_ns: int, p_WB: object, v_WB_W: object, *, yaw: float = 0.0) -> OdometrySample:
    R_WB = so3.exp([0.0, 0.0, yaw])
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=np.array(p_WB, dtype=float),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
        v_WB_B=R_WB.T @ np.array(v_WB_W, dtype=float),
        w_WB_B=np.zeros(3),
    )


def waiting(**changes: object) -> LiveReference:
    reference = live(**changes)
    reference.engage(False)
    return reference


MODES = [
    {"mode": "on_request"},
    {"mode": "at_once", "trajectory": "lemniscate"},
    {"mode": "at_once", "trajectory": "square"},
]


@pytest.mark.parametrize("changes", MODES)
def test_reference_waits_at_the_vehicle_while_disengaged(
    changes: dict[str, object],
) -> None:
    reference = waiting(**changes)
    assert reference.window(START) is None
    reference.landed(False)
    for k in range(200):  # carried about, at 2 m/s
        now = START + k * SECOND // 50
        reference.observe(moving(now, [0.04 * k, 1.0, 2.0], [2.0, 0.0, 0.0], yaw=0.5))
        window = reference.window(now)
        assert window is not None
        assert_allclose(window.p_WB[0], [0.04 * k, 1.0, 2.0], atol=1e-9)
        assert_allclose(window.v_WB_W[0], [2.0, 0.0, 0.0], atol=1e-9)
        assert np.linalg.norm(window.p_WB[-1] - window.p_WB[0]) < 2.5
        assert reference.mode(now) == "waiting"
        assert not reference.started
    for request in (reference.start, reference.hold, reference.land, reference.take_off):
        assert "engage" in request(now).text
    moved = reference.move(now, velocity(1.0, 0.0, 0.0))
    assert moved is not None and "engage" in moved.text
    reference.landed(True)
    window = reference.window(now)
    assert window is not None
    assert_allclose(window.p_WB - [7.96, 1.0, 2.0], np.zeros_like(window.p_WB))
    assert idles(window, 9.81)


@pytest.mark.parametrize("speed", [0.0, 0.3, 4.0])
def test_engaging_in_flight_brakes_from_the_current_motion(speed: float) -> None:
    reference = waiting()
    reference.landed(False)
    reference.observe(moving(START, [1.0, 2.0, 3.0], [0.0, speed, 0.0], yaw=-1.0))
    before = reference.window(START + SECOND // 50)
    answer = reference.engage(True)
    assert answer is not None and answer.accepted
    assert_same_windows(reference.window(START + SECOND // 50), before)
    window = reference.window(START)
    assert window is not None
    assert_allclose(window.p_WB[0], [1.0, 2.0, 3.0], atol=1e-9)
    assert_allclose(window.v_WB_W[0], [0.0, speed, 0.0], atol=1e-9 if speed != 0.0 else 0.0)
    later = START + 10 * SECOND
    assert reference.mode(later) == "hold"
    assert place(reference, later)[2] == pytest.approx(3.0)
    assert reference.start(later).accepted


def test_stays_on_the_ground_until_a_request() -> None:
    reference = waiting()
    reference.landed(True)
    reference.observe(odometry(START, 3.0, 4.0, 1.0))
    reference.engage(True)
    later = START + 60 * SECOND
    assert reference.mode(later) == "ground"
    assert_allclose(place(reference, later), [3.0, 4.0, 1.0])
    assert reference.take_off(later).accepted
    assert_allclose(place(reference, later + 10 * SECOND), [3.0, 4.0, 2.5], atol=1e-6)


def test_follows_the_ground_state_of_the_mpc() -> None:
    """Whatever the stack says of it, and however its height drifts."""
    reference = waiting()
    reference.landed(False)
    reference.set_ground_state(GroundState.ON_GROUND)
    reference.observe(odometry(START, 3.0, 4.0, 1.0))
    reference.engage(True)
    now = START + SECOND
    reference.observe(odometry(now, 3.0, 4.0, 1.5))
    window = reference.window(now)
    assert window is not None and idles(window, 9.81)
    assert reference.take_off(now).accepted
    window = reference.window(now)
    assert window is not None and not idles(window, 9.81)
    assert_allclose(place(reference, now + 10 * SECOND), [3.0, 4.0, 3.0], atol=1e-6)


def test_take_off_follows_a_slipping_vehicle_until_flight() -> None:
    reference = live()
    reference.observe(odometry(START))
    assert reference.take_off(START).accepted
    reference.set_ground_state(GroundState.LIFTING_OFF)
    now = START + SECOND // 2
    climbed = place(reference, now)[2]
    reference.observe(odometry(now, 0.3, -0.2, 0.05))
    assert reference.needs_odometry(now)
    assert_allclose(place(reference, now), [0.3, -0.2, climbed], atol=1e-6)
    reference.set_ground_state(GroundState.FLYING)
    reference.observe(odometry(now, 0.8, -0.2, 0.2))
    assert_allclose(place(reference, now), [0.3, -0.2, climbed], atol=1e-6)
    assert_allclose(place(reference, now + 10 * SECOND), [0.3, -0.2, 1.5], atol=1e-6)


def test_a_take_off_that_leads_on_to_a_goal_does_not_move() -> None:
    reference = waiting(mode="at_once", trajectory="lemniscate")
    reference.observe(odometry(START))
    reference.engage(True)
    now = START + SECOND // 2
    reference.set_ground_state(GroundState.LIFTING_OFF)
    planned = reference.window(now)
    reference.observe(odometry(now, 0.3, 0.0, 0.05))
    assert reference.mode(now) == "takeoff"
    assert_same_windows(planned, reference.window(now))


def test_landing_ends_with_the_mpcs_ground_state() -> None:
    reference, now = hovering()
    reference.set_ground_state(GroundState.FLYING)
    assert reference.land(now).accepted
    for _ in range(500):  # held in the air, or standing on what moves
        now += SECOND // 50
        reference.observe(odometry(now))
    assert reference.mode(now) == "landing"
    reference.set_ground_state(GroundState.ON_GROUND)
    reference.observe(odometry(now + SECOND // 50))
    assert reference.mode(now + SECOND // 50) == "ground"


def test_sinks_if_the_vehicle_flies_while_the_reference_is_on_the_ground() -> None:
    reference = live()
    reference.observe(odometry(START, 0.0, 0.0, 8.0))
    reference.set_ground_state(GroundState.FLYING)
    now = START + SECOND
    reference.observe(odometry(now, 0.0, 0.0, 7.7))
    assert reference.mode(now) == "landing"
    assert_allclose(place(reference, now + SECOND), [0.0, 0.0, 7.4], atol=1e-6)


def test_at_once_on_the_ground_it_takes_off_and_then_flies_the_trajectory() -> None:
    reference = waiting(mode="at_once", trajectory="lemniscate")
    reference.observe(odometry(START))
    reference.engage(True)
    assert reference.mode(START) == "takeoff"
    seen = [reference.mode(START + k * SECOND // 10) for k in range(300)]
    assert list(dict.fromkeys(seen)) == ["takeoff", "going", "tracking"]
    steps = np.diff([place(reference, START + k * SECOND // 100) for k in range(3000)], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.06


def test_trajectory_with_jumps_starts_after_engagement() -> None:
    reference = waiting(mode="at_once", trajectory="square")
    reference.observe(odometry(START))
    reference.engage(True)
    server = ReferenceServer(ReferenceConfig())
    server.start(START)
    assert_same_windows(reference.window(START + 3 * SECOND), server.window(START + 3 * SECOND))


def test_waits_at_vehicle_after_release() -> None:
    reference = waiting()
    reference.observe(odometry(START))
    reference.engage(True)
    reference.take_off(START)
    now = START + 10 * SECOND
    reference.start(now)
    now += 5 * SECOND
    assert reference.engage(False) is not None
    assert reference.engage(False) is None
    # Without a ground state of the stack, the height decides: the vehicle is in the air.
    reference.observe(moving(now, [20.0, 0.0, 7.0], [0.0, 0.0, 0.0]))
    assert_allclose(place(reference, now), [20.0, 0.0, 7.0])
    reference.engage(True)
    assert_allclose(place(reference, now + 10 * SECOND), [20.0, 0.0, 7.0])
    assert reference.land(now).accepted


def test_continues_when_reported_engaged() -> None:
    reference = live(mode="at_once", trajectory="circle")
    reference.observe(odometry(START))
    before = reference.window(START + SECOND)
    assert reference.engage(True) is None
    assert_same_windows(reference.window(START + SECOND), before)


def test_version_changes_only_with_the_plan() -> None:
    def version() -> object:
        assert reference.published is not None
        return reference.published.version

    reference, now = hovering()
    holding = version()
    reference.window(now)
    assert reference.land(now + 60 * SECOND).accepted
    landing = version()
    assert landing is not holding and version() is landing
    assert reference.hold(now + 61 * SECOND).accepted
    assert version() is not landing
    reference.engage(False)
    assert version() is None, "the reference waits at a vehicle that may move"
    reference.engage(True)
    assert version() not in (None, landing)


def test_unpreviewed_jump_is_a_change() -> None:
    def changes(reference: LiveReference, after_ns: int, until_ns: int) -> bool:
        reference.observe(odometry(START))
        assert reference.published is not None
        return reference.published.changes(after_ns, until_ns)

    square = live(mode="at_once", trajectory="square", preview=False, dwell_time=2.0)
    assert not changes(square, START + SECOND, START + 2 * SECOND - 1)
    assert changes(square, START + 2 * SECOND - 1, START + 2 * SECOND)
    previewed = live(mode="at_once", trajectory="square", preview=True, dwell_time=2.0)
    assert not changes(previewed, START, START + 10 * SECOND)


def velocity(*v: float, yaw_rate: float = 0.0, heading_aligned: bool = True) -> VelocityCommand:
    return VelocityCommand(
        velocity=np.array(v), yaw_rate=yaw_rate, heading_aligned=heading_aligned
    )


def moved(
    reference: LiveReference, now: int, command: VelocityCommand, seconds: float
) -> tuple[int, list[ReferenceWindow]]:
    """Command a velocity 50 times a second; return the time then, and the windows meanwhile."""
    windows = []
    for _ in range(round(50 * seconds)):
        reference.move(now, command)
        now += SECOND // 50
        windows.append(reference.window(now))
    assert None not in windows
    return now, [window for window in windows if window is not None]


def assert_continuous(windows: list[ReferenceWindow], *, dt: float = 0.02) -> None:
    for one, other in itertools.pairwise(windows):
        mean = 0.5 * (one.v_WB_W[0] + other.v_WB_W[0])
        assert_allclose(other.p_WB[0] - one.p_WB[0], dt * mean, atol=1e-3)
        mean = 0.5 * (one.a_WB_W[0] + other.a_WB_W[0])
        assert_allclose(other.v_WB_W[0] - one.v_WB_W[0], dt * mean, atol=5e-3)
        R_one, R_other = (so3.rotation_from_quaternion_xyzw(w.q_WB_xyzw[0]) for w in (one, other))
        mean = 0.5 * (one.w_WB_W[0] + other.w_WB_W[0])
        assert_allclose(so3.log(R_other @ R_one.T), dt * mean, atol=1e-2)


def test_a_velocity_is_flown_and_its_end_brakes_to_a_hold() -> None:
    reference, now = hovering()
    before = place(reference, now)
    first = reference.move(now, velocity(1.0, 0.0, 0.2))
    assert first is not None
    assert first.accepted
    now, windows = moved(reference, now, velocity(1.0, 0.0, 0.2), 3.0)
    assert reference.mode(now) == "velocity"
    assert_allclose(windows[-1].v_WB_W[0], [1.0, 0.0, 0.2], atol=1e-6)
    gone = place(reference, now)
    # Commands stop: the timeout, braking, rest.
    assert reference.mode(now + 2 * SECOND) == "hold"
    rest = place(reference, now + 2 * SECOND)
    assert 0.5 < np.linalg.norm(rest - gone) < 1.0 * (0.5 + 0.5 + 0.25)
    assert rest[0] > before[0] + 2.0
    assert_allclose(rest[1], before[1], atol=1e-9)


def test_released_stick_brakes_earlier_than_a_lost_command() -> None:
    ends = []
    for released in (True, False):
        reference, now = hovering()
        now, _ = moved(reference, now, velocity(1.0, 0.0, 0.0), 3.0)
        gone = place(reference, now)
        if released:
            reference.move(now, velocity(0.0, 0.0, 0.0))
        ends.append(float(np.linalg.norm(place(reference, now + 5 * SECOND) - gone)))
    assert ends[0] < 0.6
    assert ends[0] < ends[1] - 0.2


def test_is_continuous_from_hold_through_velocities_to_hold_goal_and_landing() -> None:
    reference, now = hovering()
    windows: list[ReferenceWindow] = []
    for each in (
        velocity(2.0, 0.0, 0.0, yaw_rate=1.5),
        velocity(-1.0, 1.0, 0.3, heading_aligned=False),
        velocity(0.0, 0.0, 0.0, yaw_rate=-2.0),
        velocity(0.0, -3.0, 0.0),
    ):
        now, seen = moved(reference, now, each, 1.5)
        windows += seen
    assert reference.hold(now).accepted
    now, seen = moved(reference, now, velocity(0.0, 0.0, 0.0), 5.0)
    windows += seen
    assert reference.mode(now) == "hold"
    assert reference.go_to(
        now, frame_id="odom", p_WB=np.array([1.0, 1.0, 2.0]), q_WB_xyzw=LEVEL
    ).accepted
    now, seen = moved(reference, now, velocity(0.0, 0.0, 0.0), 0.5)  # does not end the goal
    windows += seen
    assert reference.mode(now) == "going"
    now, seen = moved(reference, now, velocity(0.0, 1.0, 0.0), 1.0)
    windows += seen
    assert reference.mode(now) == "velocity"
    assert reference.land(now).accepted
    now, seen = moved(reference, now, velocity(0.0, 1.0, 0.0), 1.0)
    windows += seen
    assert reference.mode(now) == "landing"
    assert_continuous(windows)


def test_a_velocity_takes_over_a_trajectory_without_a_jump() -> None:
    reference, now = hovering(trajectory="circle")
    assert reference.start(now).accepted
    now += 10 * SECOND
    assert reference.mode(now) == "tracking"
    now, before = moved(reference, now, velocity(0.0, 0.0, 0.0), 0.5)
    assert reference.mode(now) == "tracking"
    now, after = moved(reference, now, velocity(0.5, 0.0, 0.0), 3.0)
    assert_continuous([*before, *after])
    assert_allclose(np.linalg.norm(after[-1].v_WB_W[0]), 0.5, atol=1e-3)


def test_no_velocity_on_the_ground_in_take_off_and_landing() -> None:
    reference = live()
    push = velocity(1.0, 0.0, 0.0)
    early = reference.move(START, push)
    assert early is not None
    assert not early.accepted
    reference.observe(odometry(START))
    ground = reference.move(START, push)
    assert ground is not None
    assert ground.text == "velocity is rejected in mode ground"
    assert reference.move(START, velocity(0.0, 0.0, 0.0)) is None
    assert reference.take_off(START).accepted
    climbing = reference.move(START + SECOND, push)
    assert climbing is not None
    assert climbing.text == "velocity is rejected in mode takeoff"


def test_velocities_stay_inside_the_fence_and_above_the_ground() -> None:
    walls = {"fence.minimum": [-2.0, -1.0, 0.0], "fence.maximum": [2.0, 1.0, 2.5]}
    reference, now = hovering(max_speed=4.0, max_acceleration=4.0, **walls)
    for each in (
        velocity(4.0, 1.0, 0.0),
        velocity(-3.0, -4.0, 2.0),
        velocity(0.0, 4.0, -4.0),
        velocity(0.0, 0.0, -1.0),
    ):
        now, windows = moved(reference, now, each, 3.0)
        # The whole preview too: a vehicle that loses its joystick follows it.
        places = np.concatenate([window.p_WB for window in windows])
        assert (np.abs(places[:, 0]) < 2.0 - 0.29).all()
        assert (np.abs(places[:, 1]) < 1.0 - 0.29).all()
        assert (places[:, 2] > 0.29).all()
        assert (places[:, 2] < 2.5 - 0.29).all()


@pytest.mark.parametrize("asked", ["goal", "trajectory", "takeoff"])
def test_refuses_requests_that_leave_the_fence(asked: str) -> None:
    reference, now = hovering(**{"fence.maximum": [2.0, 2.0, 2.5]})
    if asked == "goal":
        reply = reference.go_to(
            now, frame_id="odom", p_WB=np.array([1.0, 2.5, 1.0]), q_WB_xyzw=LEVEL
        )
    elif asked == "trajectory":
        reply = reference.follow(now, message([[0, 0, 1], [0, 2.5, 1]], [0, 5]))
    else:
        reference = live(takeoff_height=3.0, **{"fence.maximum": [2.0, 2.0, 2.5]})
        reference.observe(odometry(START))
        reply = reference.take_off(START)
    assert not reply.accepted
    assert "outside the fence" in reply.text


def test_velocity_continues_after_an_odometry_jump() -> None:
    reference, now = hovering()
    now, _ = moved(reference, now, velocity(1.0, 0.0, 0.0), 2.0)
    before = place(reference, now)
    step = np.array([3.0, -1.0, 0.2])
    reference.reset_estimate(now, EstimateReset(stamp_ns=now, turn=0.0, step_W=step))
    assert_allclose(place(reference, now), before + step, atol=1e-9)
    _, windows = moved(reference, now, velocity(1.0, 0.0, 0.0), 2.0)
    assert_continuous(windows)
    assert_allclose(windows[-1].v_WB_W[0], [1.0, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize("most", [2.0, 30.0])
def test_velocities_are_feasible_for_all_parameters(most: float) -> None:
    """Thrust and body rates of the worst commands, judged as a trajectory is."""
    rng = np.random.default_rng(4)
    reference, now = hovering(
        trajectory="hover", max_acceleration=most, max_speed=most, limit_margin=0.2
    )
    windows: list[ReferenceWindow] = []
    for _ in range(25):
        command = velocity(*rng.normal(0.0, most, 3), yaw_rate=rng.normal(0.0, 9.0))
        now, seen = moved(reference, now, command, 0.4)
        windows += seen
    config = ReferenceConfig.build({"limit_margin": 0.2})
    vehicle = config.vehicle()
    fields = ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")
    samples = TrajectorySamples(
        **{name: np.array([getattr(window, name)[0] for window in windows]) for name in fields}
    )
    needs = needs_of(samples, vehicle, seconds=0.02 * np.arange(len(windows)))
    hover = vehicle.hover_throttle
    assert needs.throttle.min() > 0.2 * hover
    assert needs.throttle.max() < hover + 0.8 * (1.0 - hover)
    assert (np.abs(needs.w_WB_B) < 0.8 * np.array(config.rate_limits)).all()
    assert_continuous(windows)


def test_accepts_a_touchdown_stamped_in_the_past() -> None:
    """The touchdown follows from an odometry, whose stamp is in the past in real time."""
    reference, clock, now = live(), [START], START + 10 * SECOND
    reference.too_late = lambda start_ns: clock[0] > start_ns
    reference.observe(odometry(START))
    assert reference.take_off(START).accepted
    clock[0] = now
    assert reference.land(now).accepted
    replies, state = [], GroundState.FLYING
    for k in range(20 * 50):
        stamp = now + k * SECOND // 50
        clock[0] = stamp + 5_000_000  # on its way
        height = place(reference, stamp)[2]
        state = GroundState.ON_GROUND if height < -0.1 else state
        reference.set_ground_state(state)
        replies.append(reference.observe(odometry(stamp, 0.0, 0.0, max(height, 0.0))))
    events = [reply for reply in replies if reply is not None]
    assert [reply.accepted for reply in events] == [True]
    assert reference.mode(now + 21 * SECOND) == "ground"


def standing() -> tuple[LiveReference, int]:
    reference = live()
    reference.observe(odometry(START))
    return reference, START + SECOND


def waits_in_the_air() -> tuple[LiveReference, int]:
    reference, now = hovering()
    reference.engage(False)
    reference.observe(moving(now, [1.0, 2.0, 3.0], [1.0, 0.0, 0.0]))
    return reference, now


def sinking() -> tuple[LiveReference, int]:
    reference, now = hovering()
    assert reference.land(now).accepted
    return reference, now + 20 * SECOND


STEP = EstimateReset(stamp_ns=START, turn=0.5, step_W=np.array([5.0, 0.0, 1.0]))
Write = Callable[[LiveReference, int], object]
WRITES: dict[str, tuple[Callable[[], tuple[LiveReference, int]], Write]] = {
    "engages": (waits_in_the_air, lambda reference, now: reference.engage(True)),
    "disengages": (hovering, lambda reference, now: reference.engage(False)),
    "moves while it waits": (
        waits_in_the_air,
        lambda reference, now: reference.observe(moving(now, [4.0] * 3, [0.0] * 3)),
    ),
    "lands while it waits": (waits_in_the_air, lambda reference, now: reference.landed(True)),
    "is on the ground while it waits": (
        waits_in_the_air,
        lambda reference, now: reference.set_ground_state(GroundState.ON_GROUND),
    ),
    "is reset while it waits": (
        waits_in_the_air,
        lambda reference, now: reference.reset_estimate(now, STEP),
    ),
    "is reset": (hovering, lambda reference, now: reference.reset_estimate(now, STEP)),
    "lands": (hovering, lambda reference, now: reference.land(now)),
    "touches the ground": (
        sinking,
        lambda reference, now: [reference.landed(True), reference.observe(odometry(now, 0, 0, 1))],
    ),
}


@pytest.mark.parametrize("case", WRITES)
def test_windows_of_other_threads_are_consistent_snapshots(case: str) -> None:
    """The publishing thread is interrupted at each of its bytecodes, and the other one, too."""
    make, change = WRITES[case]
    shown: list[ReferenceWindow | None] = []

    template, now = make()

    def prepared() -> tuple[Callable[[], ReferenceWindow | None], Callable[[], object]]:
        reference = copy.deepcopy(template)
        return lambda: reference.window(now + SECOND), lambda: change(reference, now)

    read, write = prepared()
    before = read()
    traced(write, lambda: shown.append(read()), live_module, timeline)
    after = read()
    shown += interleaved(prepared, live_module)
    assert len(shown) > 50
    for window in shown:
        assert same_window(window, before) or same_window(window, after), window
