# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The acting command at each time, and the prediction of the state when the next one acts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fixtures.presets import agile

from quad_mpc_ros.control.estimation.command_history import Acting, CommandHistory, acting_between
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.model.vehicle import Vehicle

MS = 1_000_000
VEHICLE = Vehicle()


def throttle(value: float) -> Input:
    return Input(throttle=value, w_WB_B=np.zeros(3))


def between(history: CommandHistory, start_ns: int, end_ns: int) -> Acting:
    return acting_between(history.acts_ns, history.commands, start_ns=start_ns, end_ns=end_ns)


def test_commands_act_after_the_delay_and_until_the_next() -> None:
    history = CommandHistory(delay_ns=25 * MS, initial=throttle(0.3).vector())
    history.record(throttle(0.5).vector(), stamp_ns=0)
    history.record(throttle(0.7).vector(), stamp_ns=20 * MS)
    acting = between(history, 10 * MS, 60 * MS)
    np.testing.assert_allclose(acting.durations, [0.015, 0.020, 0.015], atol=1e-12)
    np.testing.assert_array_equal(acting.commands[:, 0], [0.3, 0.5, 0.7])


def test_the_later_of_two_commands_with_one_stamp_acts() -> None:
    history = CommandHistory(delay_ns=0, initial=throttle(0.3).vector())
    history.record(throttle(0.5).vector(), stamp_ns=20 * MS)
    history.record(throttle(0.7).vector(), stamp_ns=20 * MS)
    np.testing.assert_array_equal(between(history, 20 * MS, 40 * MS).commands[:, 0], [0.7])
    np.testing.assert_array_equal(between(history, 10 * MS, 40 * MS).commands[:, 0], [0.3, 0.7])


def test_after_a_clock_was_set_back_the_new_commands_act() -> None:
    history = CommandHistory(delay_ns=0, initial=throttle(0.3).vector())
    history.record(throttle(0.5).vector(), stamp_ns=1000 * MS)
    history.record(throttle(0.7).vector(), stamp_ns=20 * MS)
    np.testing.assert_array_equal(between(history, 20 * MS, 40 * MS).commands[:, 0], [0.7])


@pytest.mark.parametrize("period_ms", [20, 1], ids=["forgets", "grows"])
def test_a_long_flight_keeps_the_last_two_seconds(period_ms: int) -> None:
    history = CommandHistory(delay_ns=0, initial=throttle(0.3).vector())
    stamps = np.arange(0, 20_000, period_ms)
    for stamp in stamps:
        history.record(throttle(stamp * 1e-5).vector(), stamp_ns=int(stamp) * MS)
    last = int(stamps[-1]) * MS
    acting = between(history, last - 1_900 * MS, last)
    assert acting.durations.sum() == pytest.approx(1.9, abs=1e-9)
    assert len(acting.commands) == 1_900 // period_ms
    np.testing.assert_allclose(np.diff(acting.commands[:, 0]), period_ms * 1e-5)
    assert history.acts_ns[0] <= last - 1_900 * MS


def test_command_intervals_cover_the_whole_time() -> None:
    rng = np.random.default_rng(0)
    history = CommandHistory(delay_ns=13 * MS, initial=throttle(0.3).vector())
    for stamp in np.cumsum(rng.integers(1, 40, 50)) * MS:
        history.record(throttle(float(rng.random())).vector(), stamp_ns=int(stamp))
    for start in range(0, 900, 37):
        total = between(history, start * MS, (start + 31) * MS).durations.sum()
        assert total == pytest.approx(0.031, abs=1e-12)


def test_without_delay_the_state_is_the_odometry() -> None:
    compensation = DelayCompensation(agile())
    odometry = _odometry(stamp_ns=20 * MS)
    state = compensation.predict(odometry)
    assert state.stamp_ns == 20 * MS
    np.testing.assert_array_equal(state.x.p_WB, odometry.p_WB)
    np.testing.assert_allclose(state.x.v_WB_B, odometry.v_WB_B, atol=1e-15)


def test_free_fall_across_the_delay() -> None:
    """With the motors off for long enough, the predicted state is in free fall."""
    config = agile(input_delay=0.033, drag=0.0, thrust_curve=(1.88, 2.8, 0.0))
    compensation = DelayCompensation(config)
    compensation.record(throttle(0.0), stamp_ns=-100 * MS)
    state = compensation.predict(_odometry(stamp_ns=0, v_WB_B=np.array([1.0, 0.0, 0.0])))
    assert state.stamp_ns == 33 * MS
    np.testing.assert_allclose(state.x.p_WB, [0.033, 0.0, 5.0 - 0.5 * 9.81 * 0.033**2], atol=1e-9)
    np.testing.assert_allclose(state.x.v_WB_W, [1.0, 0.0, -9.81 * 0.033], atol=1e-9)


def test_body_rates_rotate_the_predicted_state() -> None:
    compensation = DelayCompensation(agile(input_delay=0.03))
    compensation.record(Input(throttle=0.3, w_WB_B=np.array([0.0, 0.0, 2.0])), stamp_ns=-10 * MS)
    state = compensation.predict(_odometry(stamp_ns=0))
    # Sent 10 ms ago with a delay of 30 ms: it acts for the last 10 ms of the 30 ahead.
    np.testing.assert_allclose(so3.log(state.x.R_WB), [0.0, 0.0, 2.0 * 0.010], atol=1e-12)


def test_engaging_drops_commands_that_were_not_executed() -> None:
    compensation = DelayCompensation(agile(input_delay=0.03))
    spin = Input(throttle=0.9, w_WB_B=np.array([0.0, 0.0, 5.0]))
    compensation.engage(False)
    for stamp_ns in range(-100 * MS, 0, 20 * MS):
        compensation.record(spin, stamp_ns=stamp_ns)
    compensation.engage(True)
    ahead = compensation.predict(_odometry(stamp_ns=0)).x
    np.testing.assert_allclose(ahead.R_WB, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(ahead.v_WB_W, 0.0, atol=1e-9)  # at hover, where another flew it


@pytest.mark.parametrize(
    ("engagements", "first", "last"),
    [
        ({}, 1, 99),
        ({0: False, 20: True}, 20 + 16, 99),  # 0.3 s after the first of them acts
        ({20: False}, 1, 20),  # the earlier estimate is restored at the end
        ({0: False}, None, None),
    ],
)
def test_estimates_only_while_commands_are_executed(
    engagements: dict[int, bool], first: int | None, last: int | None
) -> None:
    """The vehicle drifts at a constant speed, whatever the commands are."""
    compensation = DelayCompensation(agile())
    learned = []
    for k in range(100):
        if k in engagements:
            compensation.engage(engagements[k])
        odometry = _odometry(stamp_ns=20 * MS * k, v_WB_B=np.array([1.0, 0.0, 0.0]))
        learned.append(float(compensation.predict(odometry).parameters[()].a_W[0]))
        compensation.record(throttle(0.3), stamp_ns=20 * MS * k)
    changes = np.flatnonzero(np.diff(learned)) + 1
    assert (min(changes, default=None), max(changes, default=None)) == (first, last)


def test_drift_of_the_velocity_is_known_when_commands_begin_to_act() -> None:
    """As of PX4: the position moves at a velocity of zero. A jump would tilt the vehicle."""
    compensation = DelayCompensation(agile())
    compensation.engage(False)
    errors = []
    for k in range(100):
        if k == 50:
            compensation.engage(True)
        odometry = _odometry(stamp_ns=20 * MS * k)
        odometry = dataclasses.replace(odometry, p_WB=np.array([0.0, -0.01 * k, 5.0]))
        predicted = compensation.predict(odometry).x
        errors.append(predicted.p_WB[1] - odometry.p_WB[1])
        compensation.record(throttle(VEHICLE.hover_throttle), stamp_ns=20 * MS * k)
    assert compensation.status.text == "learn"
    assert np.abs(errors[25:]).max() < 0.02


@pytest.mark.parametrize("event", ["disengaged", "landed"])
def test_restores_an_estimate_from_before_a_touchdown(event: str) -> None:
    """A landing is detected late, and disarming at the touchdown leaves no time for it."""
    ground = GroundDetector()
    ground.state = GroundState.FLYING
    compensation = DelayCompensation(agile(), ground=ground)
    learned, p_WB = [], np.array([0.0, 0.0, 5.0])
    for k in range(600):
        if k == 550 and event == "landed":
            ground.state = GroundState.ON_GROUND
        elif k == 550:
            compensation.engage(False)
        pushed = np.array([0.02 * k if k < 100 else 2.0, 0.0, 0.04 * max(k - 500, 0)])
        p_WB = p_WB + 0.02 * pushed
        odometry = _odometry(stamp_ns=20 * MS * k, v_WB_B=pushed)
        odometry = dataclasses.replace(odometry, p_WB=p_WB)
        learned.append(np.array(compensation.predict(odometry).parameters[()].a_W))
        compensation.record(throttle(VEHICLE.hover_throttle), stamp_ns=20 * MS * k)
    assert learned[549][2] > 0.5
    assert any(np.array_equal(learned[550], learned[k]) for k in range(300, 350))
    np.testing.assert_array_equal(learned[550], learned[-1])


def test_continuous_jumps_reset_estimate() -> None:
    compensation = DelayCompensation(agile())
    statuses = []
    for k in range(200):
        speed = 3.0 if k % 2 and k > 100 else 0.0  # back and forth
        odometry = dataclasses.replace(
            _odometry(stamp_ns=20 * MS * k), v_WB_B=np.array([speed, 0.0, 0.0])
        )
        compensation.predict(odometry)
        compensation.record(throttle(VEHICLE.hover_throttle), stamp_ns=20 * MS * k)
        statuses.append(compensation.status)
    assert {status.text for status in statuses[2:100]} == {"learn"}
    assert statuses[102].text == "reject"
    assert statuses[-1][:2] == ("reset", 1)


def _odometry(*, stamp_ns: int, v_WB_B: np.ndarray | None = None) -> OdometrySample:
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=np.array([0.0, 0.0, 5.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.zeros(3) if v_WB_B is None else v_WB_B,
        w_WB_B=np.zeros(3),
    )


def test_predicts_over_the_extra_latency_of_an_odometry() -> None:
    """One that was late by 40 ms, as one in time of a vehicle whose delay is 40 ms longer."""
    known = agile(input_delay=0.02, estimate_disturbance=False)
    slower = dataclasses.replace(known, input_delay=0.06)
    odometry = OdometrySample(
        stamp_ns=100 * MS,
        p_WB=np.array([0.5, -0.2, 1.0]),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(so3.exp(np.array([0.3, -0.2, 0.1]))),
        v_WB_B=np.array([2.0, 1.0, -0.5]),
        w_WB_B=np.array([1.0, -2.0, 0.5]),
    )
    late, in_time = DelayCompensation(known), DelayCompensation(slower)
    for stamp_ns, value in ((60 * MS, 0.6), (80 * MS, 0.2)):
        late.record(throttle(value), stamp_ns=stamp_ns + 40 * MS)
        in_time.record(throttle(value), stamp_ns=stamp_ns)
    found = late.predict(odometry, late_ns=40 * MS)
    expected = in_time.predict(odometry)
    assert found.stamp_ns == expected.stamp_ns == 160 * MS
    np.testing.assert_array_equal(found.x.p_WB, expected.x.p_WB)
    np.testing.assert_array_equal(found.x.R_WB, expected.x.R_WB)
    assert np.linalg.norm(found.x.p_WB - odometry.p_WB) > 0.1
