# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A clock that is set, back or on: nothing is read that is not there, nothing wrong is learned."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fixtures.planner import Planner
from fixtures.presets import agile
from numpy.testing import assert_allclose

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.command_history import CommandHistory, acting_between
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]

MS = 1_000_000
START = 1_700_000_000_000 * MS
DAY = 86_400_000 * MS
HOVER = Input(throttle=0.3, w_WB_B=np.zeros(3))


@pytest.mark.parametrize("shift", [-DAY, -100 * MS])
def test_restarts_planning_after_a_clock_change(
    shift: int, make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    aside = np.array([-1.0, 0.5, 2.0])
    mpc, fresh = Planner(agile()), Planner(agile())
    mpc.step(make_odometry(START, p_WB=aside), make_window(START))
    stamp = START + shift
    step = mpc.step(make_odometry(stamp, p_WB=aside), make_window(stamp))
    cold = fresh.step(make_odometry(stamp, p_WB=aside), make_window(stamp))
    assert step.plan is not None
    assert cold.plan is not None
    assert_allclose(step.plan.inputs[0], cold.plan.inputs[0], atol=0.2)


def test_drops_commands_from_the_future() -> None:
    history = CommandHistory(delay_ns=0, initial=HOVER.vector())
    history.record(np.array([0.9, 0.0, 0.0, 0.0]), stamp_ns=START)
    sent = np.array([0.4, 0.0, 0.0, 0.0])
    for tick in range(10_000):
        history.record(sent, stamp_ns=START - DAY + tick * 20 * MS)
    now = START - DAY + 10_000 * 20 * MS
    acting = acting_between(
        history.acts_ns, history.commands, start_ns=now - 1000 * MS, end_ns=now
    )
    assert len(acting.commands) > 0
    assert_allclose(acting.commands, np.tile(sent, (len(acting.commands), 1)))
    # Nothing grows until the clock is where it was.
    assert history.acts_ns[0] > now - 120_000 * MS


@pytest.mark.parametrize("shift", [-5000 * MS, 5000 * MS])
def test_no_estimation_across_a_jump_of_the_stamps(
    shift: int, make_odometry: MakeOdometry
) -> None:
    compensation = DelayCompensation(MpcConfig())
    hover = Input(throttle=MpcConfig().vehicle().hover_throttle, w_WB_B=np.zeros(3))
    rising = {"v_WB_B": np.array([0.0, 0.0, 2.0])}
    for stamp in (START, START + 20 * MS, START + shift, START + shift + 20 * MS):
        # 0.4 m/s^2 of drag in a period is little; across five seconds it would be all of it.
        model = compensation.predict(make_odometry(stamp, **rising)).parameters[()]
        compensation.record(hover, stamp_ns=stamp)
    assert_allclose(model.a_W, np.zeros(3), atol=0.1)
    assert model.thrust_scale == pytest.approx(1.0, abs=0.05)
