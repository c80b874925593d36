# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of the odometry are rejected; noise, small and announced steps are accepted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fixtures.scripts import script_module
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.odometry_jumps import OdometryJumps
from quad_mpc_ros.control.stage import StageLog

SECOND = 1_000_000_000
Where = Callable[[float], Array]
FAR = np.array([30.0, 0.0, 0.0])


STEPS = script_module("bench/estimate_steps.py")
ROWS = {step.name: step for step in STEPS.steps()}


def straight(seconds: float) -> Array:
    return np.array([2.0 * seconds, 0.0, 1.0])


class Source:
    """Odometry of a vehicle that flies straight at 2 m/s, with an offset of its positions."""

    def __init__(self, rate: float = 50.0) -> None:
        self.log = StageLog()
        self.jumps = OdometryJumps(self.log)
        self._period = 1.0 / rate
        self.time = 0.0

    def observe(self, seconds: float, offset: Where | None = None) -> list[Array]:
        """Return the errors of the accepted positions, one per odometry."""
        off = []
        for _ in range(round(seconds / self._period)):
            self.time += self._period
            given = np.zeros(3) if offset is None else offset(self.time)
            odometry = OdometrySample(
                stamp_ns=round(self.time * SECOND),
                p_WB=straight(self.time) + given,
                q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
                v_WB_B=np.array([2.0, 0.0, 0.0]),
                w_WB_B=np.zeros(3),
            )
            checked = self.jumps.checked(odometry)
            assert (checked is odometry) == (not self.jumps.fault)
            off.append(checked.p_WB - straight(self.time))
        return off


def flips(period: float) -> Where:
    return lambda seconds: FAR * (int(seconds // period) % 2)


@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0])
def test_never_accepts_a_position_that_jumps_back_and_forth(rate: float) -> None:
    source = Source(rate)
    assert np.abs(source.observe(20.0, flips(2.0))).max() < 1e-6


def test_accepts_a_lasting_position_after_three_seconds() -> None:
    source = Source()
    source.observe(2.0)
    off = np.linalg.norm(source.observe(4.0, lambda _: FAR), axis=1)
    taken = int(np.argmax(off > 1.0))
    assert taken * 0.02 == pytest.approx(3.0, abs=0.05)
    assert off[taken - 1] < 1e-6 and off[-1] == pytest.approx(30.0)
    (note,) = source.log.take_warnings()
    assert "jump of 30.0 m has lasted for 3.0 s: accepted" in note


def test_accepts_a_step_back_at_once_and_another_one_later() -> None:
    source = Source()
    source.observe(2.0)
    source.observe(4.0, lambda _: FAR)
    assert np.abs(source.observe(0.1)).max() < 1e-6
    assert np.abs(source.observe(8.0, lambda _: FAR)).max() < 1e-6
    assert np.linalg.norm(source.observe(2.0, lambda _: FAR)[-1]) == pytest.approx(30.0)


def test_rejects_positions_that_do_not_agree() -> None:
    source = Source()
    source.observe(2.0)
    assert np.abs(source.observe(8.0, lambda seconds: FAR * (1.0 + seconds // 1.0))).max() < 1e-6


def test_names_the_jumped_quantity_at_once() -> None:
    source = Source()
    source.observe(2.0)
    source.observe(0.02, lambda _: FAR)
    assert "position jumped by 30.0 m" in source.jumps.fault
    source.observe(0.02)
    assert source.jumps.fault == ""


@pytest.mark.parametrize("step", [0.1, 0.5, 0.7])
def test_accepts_a_small_step_at_once(step: float) -> None:
    source = Source()
    source.observe(2.0)
    off = source.observe(0.02, lambda _: np.array([0.0, step, 0.0]))
    assert off[0][1] == pytest.approx(step)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    deviation=st.sampled_from([0.01, 0.1, 0.5, 2.0]),
    rate=st.sampled_from([10.0, 50.0, 200.0]),
)
def test_accepts_noise(seed: int, deviation: float, rate: float) -> None:
    random, source = np.random.default_rng(seed), Source(rate)
    given = [random.normal(scale=deviation, size=3) for _ in range(round(20.0 * rate) + 1)]
    source.observe(20.0, lambda seconds: given[min(round(seconds * rate), len(given) - 1)])
    assert source.log.take_warnings() == []


def test_a_gap_in_the_odometry_allows_a_larger_step() -> None:
    source = Source()
    source.observe(2.0)
    source.time += 0.5
    off = source.observe(0.02, lambda _: np.array([0.0, 2.5, 0.0]))
    assert off[0][1] == pytest.approx(2.5)


@pytest.mark.parametrize("order", ["before", "after"])
def test_accepts_an_announced_step_at_once(order: str) -> None:
    """Also when it is announced after the first odometry in the new coordinates."""
    source = Source()
    source.observe(2.0)
    reset = EstimateReset(stamp_ns=round(2.02 * SECOND), turn=0.0, step_W=FAR)
    if order == "before":
        source.jumps.reset_estimate(reset)
        off = source.observe(0.5, lambda _: FAR)
        assert np.linalg.norm(off[0]) == pytest.approx(30.0)
    else:
        source.observe(0.02, lambda _: FAR)
        source.jumps.reset_estimate(reset)
        off = source.observe(0.5, lambda _: FAR)
    assert np.linalg.norm(off, axis=1) == pytest.approx(30.0)


def test_accepts_every_position_while_disengaged() -> None:
    source = Source()
    source.observe(2.0)
    source.jumps.engage(False)
    assert np.linalg.norm(source.observe(0.02, lambda _: FAR)[0]) == pytest.approx(30.0)


RATES = np.array([0.3, -0.4, 0.5])  # rad/s


def used(
    times: Array,
    *,
    turn: Callable[[float], Array] | None = None,
    push: Callable[[float], Array] | None = None,
    follows_push: bool = False,
    twist_in_world: bool = False,
) -> tuple[OdometryJumps, Array, Array]:
    """Report a vehicle that turns and flies straight at 2 m/s, 50 times a second.

    Returns:
        The jumps, and the error of attitude [rad] and velocity [m/s] that are used, each time.
    """
    jumps, p_WB, errors, off = OdometryJumps(StageLog()), np.zeros(3), [], []
    for k, seconds in enumerate(times):
        R_WB, v_WB_W = so3.exp(seconds * RATES), np.array([2.0, 0.0, 0.0])
        pushed = np.zeros(3) if push is None else push(seconds)
        p_WB = p_WB + 0.02 * (v_WB_W + (pushed if follows_push else 0.0)) if k else p_WB
        R_off = R_WB if turn is None else so3.exp(turn(seconds)) @ R_WB
        odometry = OdometrySample(
            stamp_ns=round(seconds * SECOND),
            p_WB=p_WB,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_off),
            v_WB_B=(R_off if twist_in_world else R_WB).T @ (v_WB_W + pushed),
            w_WB_B=RATES,
        )
        checked = jumps.checked(odometry)
        R_used = so3.rotation_from_quaternion_xyzw(checked.q_WB_xyzw)
        errors.append(np.linalg.norm(so3.log(R_used @ R_WB.T)))
        off.append(np.linalg.norm(R_used @ checked.v_WB_B - v_WB_W))
    return jumps, np.array(errors), np.array(off)


def between(start: float, end: float, size: Array) -> Callable[[float], Array]:
    return lambda seconds: np.where(start <= seconds < end, size, 0.0)


TIMES = np.arange(0.0, 12.0, 0.02)


@pytest.mark.parametrize("twist_in_world", [False, True])
@pytest.mark.parametrize(
    "turn", [[0.0, 0.0, 0.9], [0.0, 0.0, np.pi], [0.5, 0.0, 0.0], [0.0, 1.5, 1.0]]
)
def test_integrates_body_rates_while_the_attitude_is_off(
    turn: list[float], twist_in_world: bool
) -> None:
    """The velocity is measured in the body frame, or turns with the attitude."""
    jumps, errors, off = used(
        TIMES, turn=between(3.0, 5.9, np.array(turn)), twist_in_world=twist_in_world
    )
    assert errors.max() < 0.02
    assert off.max() < 0.1
    assert not jumps.resets


@pytest.mark.parametrize("measures_the_next", [False, True])
def test_abrupt_body_rates_are_no_jump(measures_the_next: bool) -> None:
    """A vehicle without lags has such rates; either of the two rates is reported."""
    jumps, R_WB = OdometryJumps(StageLog()), np.eye(3)
    for k in range(200):
        before, after = (np.array([20.0 * (-1.0) ** ((k + n) // 3), 0.0, 0.0]) for n in (0, 1))
        odometry = OdometrySample(
            stamp_ns=20_000_000 * k,
            p_WB=np.zeros(3),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=np.zeros(3),
            w_WB_B=after if measures_the_next else before,
        )
        assert jumps.checked(odometry) is odometry
        R_WB = R_WB @ so3.exp(0.02 * after)


def test_accepts_a_lasting_heading_and_turns_the_estimate() -> None:
    jumps, errors, _ = used(TIMES, turn=between(3.0, 8.0, np.array([0.0, 0.0, 0.9])))
    accepted = TIMES[int(np.argmax(errors > 0.5))]
    assert accepted == pytest.approx(6.0, abs=0.05)
    assert errors[TIMES > 8.01].max() < 1e-6  # and a step back at once
    there, back = jumps.resets
    assert there.turn == pytest.approx(0.9, abs=0.02)
    assert back.turn == pytest.approx(-0.9, abs=0.02)
    at = np.array([2.0 * accepted, 0.0, 0.0])
    np.testing.assert_allclose(there.points(at), at, atol=0.1)  # the vehicle stays


def test_never_accepts_a_roll_that_jumped() -> None:
    jumps, errors, _ = used(TIMES, turn=between(3.0, 12.0, np.array([0.5, 0.0, 0.0])))
    assert errors.max() < 0.02
    assert "attitude jumped by 29 degrees" in jumps.fault


@pytest.mark.parametrize("speed", [4.0, 20.0])
def test_rejects_a_velocity_that_positions_contradict(speed: float) -> None:
    _, _, off = used(TIMES, push=between(3.0, 8.0, np.array([0.0, speed, 0.0])))
    assert off.max() < 1e-6


def test_accepts_a_velocity_that_positions_confirm() -> None:
    """A vehicle that was pushed: 4 m/s from one odometry to the next."""
    push = between(3.0, 12.0, np.array([0.0, 4.0, 0.0]))
    _, _, off = used(TIMES, push=push, follows_push=True)
    confirmed = TIMES[int(np.argmax(off > 2.0))]
    assert 3.0 < confirmed < 3.4
    assert off[confirmed < TIMES] == pytest.approx(4.0)


@pytest.mark.parametrize(
    "name",
    [
        "position 2.0 m",
        "height 0.5 m",
        "heading 50°",
        "heading 180°",
        "heading 50°, announced",
        "roll 60°",
        "velocity 10.0 m/s",
    ],
)
def test_jump_displaces_a_vehicle_in_wind_no_further_with_estimator(name: str) -> None:
    on, off = (
        STEPS.moved(ROWS[name], lasts=4.0, wind=2.0, learns=learns) for learns in (True, False)
    )
    assert on <= off + 0.02
    if name.startswith(("heading", "roll 60", "velocity 10")):
        assert on < 0.1
