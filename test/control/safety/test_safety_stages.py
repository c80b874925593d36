# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Safety stages without a solver: accepted inputs, active source, limited command."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from fixtures.records import state_of
from numpy.testing import assert_allclose

from quad_mpc_ros.control.config import FenceParameters, MpcConfig
from quad_mpc_ros.control.estimate_stage import EstimateStage
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.guide import Guided
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.prediction import PredictedState, Prediction
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import Mpc, MpcStep, Planned
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.qp_solver import QpSolution
from quad_mpc_ros.control.safety.decide_stage import DecideStage
from quad_mpc_ros.control.safety.input_monitor import InputMonitor
from quad_mpc_ros.control.safety.limit_stage import LimitStage
from quad_mpc_ros.control.stage import Due, Failure, StageLog

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]

MS = 1_000_000
PERIOD = 20 * MS
START = 1_700_000_000_000 * MS


def planned(throttle: float, *rates: float) -> Plan:
    """Return a plan of one command."""
    return Plan(
        stamp_ns=START,
        step=0.05,
        input_step=0.05,
        inputs=np.array([[throttle, *(rates or (0.0, 0.0, 0.0))]]),
        p_WB=np.zeros((2, 3)),
        R_WB=np.tile(np.eye(3), (2, 1, 1)),
    )


class Flight:
    """Stages with the same odometry and reference in every period."""

    def __init__(
        self,
        config: MpcConfig,
        make_odometry: MakeOdometry,
        make_window: MakeWindow,
        *,
        ground: GroundDetector | None = None,
    ) -> None:
        self.log = StageLog()
        self.inputs = InputMonitor(config, self.log)
        estimation = EstimateStage(config, self.log)
        estimation.ground = ground or GroundDetector()
        self.deciding = DecideStage(config, self.inputs, estimation.ground, self.log)
        self.limiting = LimitStage(config, self.inputs, estimation, self.deciding, self.log)
        self.now = START
        self._make_odometry, self._make_window = make_odometry, make_window

    def tick(
        self, plan: Plan | None = None, *, fault: str = "", **odometry: Array
    ) -> tuple[str, Input | None]:
        """Return the active source and the command; then a period passes."""
        now = self.now
        assert self.inputs.accept_reference(self._make_window(now), now_ns=now)
        accepted = self.inputs.accept_odometry(self._make_odometry(now, **odometry), now_ns=now)
        assert accepted is not None
        return self._commanded(accepted, plan, Failure("plan", fault) if fault else None)

    def watch(self) -> tuple[str, Input | None]:
        assert self.inputs.is_odometry_lost(now_ns=self.now)
        return self._commanded(None, None, Failure("estimate", "skipped without odometry"))

    def _commanded(
        self, odometry: OdometrySample | None, plan: Plan | None, failure: Failure | None
    ) -> tuple[str, Input | None]:
        due = Due(odometry, self.now, self.now, self.now, 0.02, started=0.0)
        planned = Planned(None if plan is None else step_of(plan), failure)
        decided = self.deciding.step(due, planned, flown=None, acting=self.limiting.acting)
        u = self.limiting.step(due, decided, corridor=None)
        self.now += PERIOD
        return decided.decision.source.name, u


def step_of(plan: Plan | None, *, status: str = "solved", step_time: float = 0.001) -> MpcStep:
    """Return the step of an MPC that has found a plan."""
    solved, none = plan is not None, np.zeros((1, 4))
    residuals = {"primal_residual": 0.0, "dual_residual": 0.0}
    solution = QpSolution(
        solved,
        status,
        z=none,
        inputs=none,
        states=none,
        iterations=10,
        **residuals,
        solve_time=0.0,
    )
    state = PredictedState(START, Prediction.zeros())
    return MpcStep(plan, solution, 10, 0.001, step_time, state)


@pytest.fixture
def make_flight(
    make_odometry: MakeOdometry, make_window: MakeWindow
) -> Callable[[MpcConfig], Flight]:
    return lambda config: Flight(config, make_odometry, make_window)


MakeFlight = Callable[[MpcConfig], Flight]


# Nose down by 0.1 rad, and leaning to the right by as much.
LEANING = np.array([math.sin(0.05), math.sin(0.05), 0.0, math.cos(0.05)])
LEANING /= np.linalg.norm(LEANING)


@pytest.fixture
def standing(
    make_odometry: MakeOdometry, make_window: MakeWindow
) -> Callable[[GroundState], Flight]:
    """Return a maker of flights whose vehicle is in a state of the ground."""

    def flight_in(state: GroundState) -> Flight:
        ground = GroundDetector()
        ground.state = state
        config = MpcConfig(odom_timeout=0.04)
        return Flight(config, make_odometry, make_window, ground=ground)

    return flight_in


Standing = Callable[[GroundState], Flight]


@pytest.mark.parametrize("state", [GroundState.LIFTING_OFF, GroundState.TOUCHING_DOWN])
def test_only_levels_near_the_ground(standing: Standing, state: GroundState) -> None:
    flight = standing(state)
    _, u = flight.tick(planned(0.5, 3.0, -2.0, 1.0), q_WB_xyzw=LEANING)
    assert u is not None
    assert u.throttle == 0.5
    roll, pitch, yaw = u.w_WB_B
    assert roll < -0.3 and pitch < -0.3
    assert yaw == 0.0
    turned = so3.rotation_from_quaternion_xyzw(LEANING) @ so3.exp(0.05 * u.w_WB_B)
    assert turned[2, 2] > so3.rotation_from_quaternion_xyzw(LEANING)[2, 2]


def test_limits_the_thrust_of_a_take_off(standing: Standing) -> None:
    flight = standing(GroundState.LIFTING_OFF)
    vehicle = MpcConfig().vehicle()
    _, u = flight.tick(planned(1.0, 0.0, 0.0, 0.0))
    assert u is not None
    assert 2.0 < vehicle.thrust(u.throttle) / (vehicle.mass * vehicle.gravity) < 2.5


def test_levels_by_dead_reckoning_after_a_touchdown(standing: Standing) -> None:
    """Rates from the last measured attitude would turn the vehicle without end."""
    flight = standing(GroundState.TOUCHING_DOWN)
    flight.tick(planned(0.6), q_WB_xyzw=LEANING)
    flight.now += 2 * PERIOD
    turns = [flight.watch() for _ in range(40)]
    assert {source for source, _ in turns[10:]} == {"BLIND"}
    assert turns[-1][1] is not None
    assert_allclose(turns[-1][1].w_WB_B, 0.0, atol=0.01)


@pytest.mark.parametrize("age", [0 * MS, 7 * MS, 39 * MS, 40 * MS, 41 * MS, 900 * MS])
def test_returns_the_time_until_odometry_is_lost(make_flight: MakeFlight, age: int) -> None:
    flight = make_flight(MpcConfig(odom_timeout=0.04))
    assert flight.inputs.seconds_until_odometry_lost(now_ns=START) > 0.0
    seen = flight.now
    flight.tick(planned(0.3))
    pause = round(flight.inputs.seconds_until_odometry_lost(now_ns=seen + age) * 1e9)
    assert pause == max(40 * MS + 1 - age, 0)
    if pause:
        assert not flight.inputs.is_odometry_lost(now_ns=seen + age + pause - 1)
    assert flight.inputs.is_odometry_lost(now_ns=seen + age + pause)


@pytest.mark.parametrize(
    ("plan", "step_time", "fault", "counter"),
    [
        (planned(0.3), 0.009, "", ""),
        (None, 0.009, "solver: as it says", "solver_failures"),
        (planned(math.nan), 0.009, "the plan is not finite", "solver_failures"),
        (planned(0.3), 0.011, "late: the plan took 11.0 ms", "deadline_misses"),
    ],
)
def test_refuses_missing_nonfinite_or_late_plan(
    plan: Plan | None,
    step_time: float,
    fault: str,
    counter: str,
    monkeypatch: pytest.MonkeyPatch,
    make_window: MakeWindow,
) -> None:
    step = step_of(plan, status="as it says", step_time=step_time)
    monkeypatch.setattr(Mpc, "solve", lambda *_, **__: step)
    log = StageLog()
    planning = Mpc(MpcConfig(), deadline=0.01, log=log)
    due = Due(None, START, START, START, 0.02, started=0.0)
    planned = planning.step(due, step.state, Guided(make_window(START)))
    assert planned.step is step
    assert planned.failure == (Failure("plan", fault) if fault else None)
    counted = {name for name, count in log.counts.items() if count}
    assert counted == ({counter} if counter else set())


def test_uses_a_reference_that_is_recent_or_covers_the_horizon(
    make_flight: MakeFlight,
) -> None:
    config = MpcConfig(reference_timeout=0.5, horizon_steps=10, horizon_step=0.05)
    flight = make_flight(config)
    inputs = flight.inputs
    nothing = Failure("validate", "no reference yet")
    assert inputs.reference_at(START, now_ns=START) == nothing
    flight.tick(planned(0.3))
    assert inputs.reference_at(START, now_ns=START + 500 * MS) is inputs.reference
    # The window is of 2 s, the horizon of 0.5 s.
    for elapsed, taken in ((501, True), (1500, True), (1501, False)):
        now = START + elapsed * MS
        assert isinstance(inputs.reference_at(now, now_ns=now), Failure) is not taken
    early = inputs.reference_at(START - 600 * MS, now_ns=START)
    assert early == Failure("validate", "reference begins 0.60 s after the odometry's stamp")


@pytest.mark.parametrize(
    ("action", "rejected"), [("warn", False), ("hover", True), ("stop", True)]
)
def test_rejects_prediction_beyond_a_limit_with_an_action(action: str, rejected: bool) -> None:
    fence = FenceParameters(maximum=(2.0, 9.0, 9.0), action=action)
    config = MpcConfig(fence=fence)
    deciding = DecideStage(config, InputMonitor(config), GroundDetector(), StageLog())

    def state(x: float) -> PredictedState:
        prediction = Prediction.zeros()
        prediction[()].state = state_of(p_WB=(x, 0.0, 1.0), v_WB_W=(0.5, 0.0, 0.0))
        return PredictedState(0, prediction)

    assert deciding.predicted_breach(state(0.0)) == ""
    assert ("outside the fence" in deciding.predicted_breach(state(2.1))) == rejected
