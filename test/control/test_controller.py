# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller as the node uses it: inputs, commands and their times."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.config import MpcConfig, OdometryParameters
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.mpc import Mpc, MpcStep
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.simulation.closed_loop import LoopStep

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]

MS = 1_000_000
SECOND = 1_000 * MS
START = 1_700_000_000 * SECOND
PERIOD = 20 * MS


class SolverSpy:
    """Records every call of the MPC, and makes it fail on demand."""

    def __init__(self) -> None:
        self.odometries: list[OdometrySample] = []
        self.solves = 0
        self.failing = False

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        predict, solve = DelayCompensation.predict, Mpc.solve

        def predicted(
            estimator: DelayCompensation, odometry: OdometrySample, **late_ns: int
        ) -> PredictedState:
            self.odometries.append(odometry)
            return predict(estimator, odometry, **late_ns)

        def solved(mpc: Mpc, *arguments: Any, **named: Any) -> MpcStep:
            self.solves += 1
            outcome = solve(mpc, *arguments, **named)
            if not self.failing:
                return outcome
            failed = outcome.solution._replace(solved=False, status="made to fail")
            return outcome._replace(plan=None, solution=failed)

        monkeypatch.setattr(DelayCompensation, "predict", predicted)
        monkeypatch.setattr(Mpc, "solve", solved)


@pytest.fixture
def spy(monkeypatch: pytest.MonkeyPatch) -> SolverSpy:
    spy = SolverSpy()
    spy.install(monkeypatch)
    return spy


class Hovering:
    """A controller fed with hovering odometry and its reference, 50 times a second."""

    def __init__(
        self, config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow
    ) -> None:
        self.controller = Controller(config)
        self.now = START
        self._make_odometry, self._make_window = make_odometry, make_window

    def odometry(self, **changes: Any) -> Tick | None:
        """Give odometry of this moment."""
        odometry = self._make_odometry(changes.pop("stamp_ns", self.now), **changes)
        return self.controller.receive_odometry(odometry, now_ns=self.now)

    def reference(self, **changes: Any) -> Tick | None:
        """Give the reference of this moment."""
        window = self._make_window(changes.pop("stamp_ns", self.now), **changes)
        return self.controller.receive_reference(window, now_ns=self.now)

    def watch(self) -> Tick | None:
        return self.controller.watch(now_ns=self.now)

    def sleep(self, duration: int = PERIOD) -> None:
        self.now += duration

    def tick(self, **changes: Any) -> Tick:
        """Give reference and odometry, then let a period pass."""
        self.reference()
        tick = self.odometry(**changes)
        self.sleep()
        assert tick is not None
        return tick


@pytest.fixture
def hovering(
    paper_config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow
) -> Hovering:
    return Hovering(paper_config, make_odometry, make_window)


def assert_sound(tick: Tick, config: MpcConfig) -> None:
    command = tick.command
    assert command is not None
    assert config.throttle_min <= command.throttle <= config.throttle_max
    assert np.isfinite(command.w_WB_B).all()
    assert (np.abs(command.w_WB_B) <= config.omega_max).all()


# --- commands


def test_publishes_nothing_before_odometry_and_reference(
    hovering: Hovering, spy: SolverSpy
) -> None:
    assert hovering.watch() is None
    tick = hovering.odometry()
    assert tick is not None
    assert tick.command is None
    assert tick.stats.source == "waiting"
    assert spy.solves == 0
    assert hovering.watch() is None
    hovering.sleep()
    assert hovering.reference() is None
    assert hovering.tick().command is not None


# --- rejected inputs


BAD_ODOMETRY: dict[str, dict[str, Any]] = {
    "number": {"v_WB_B": np.array([0.0, math.nan, 0.0])},
    "quaternion": {"q_WB_xyzw": np.array([0.0, 0.0, 0.0, 1.002])},
    "frame": {"frame_id": "map"},
    "stamp": {"stamp_ns": START},
}


@pytest.mark.parametrize("case", BAD_ODOMETRY)
def test_bad_odometry_is_ignored_and_the_last_good_one_kept(
    hovering: Hovering, spy: SolverSpy, case: str
) -> None:
    for _ in range(3):
        hovering.tick()
    solved = len(spy.odometries)
    hovering.controller.take_warnings()

    hovering.reference()
    assert hovering.odometry(**BAD_ODOMETRY[case]) is None
    assert len(spy.odometries) == solved
    (warning,) = hovering.controller.take_warnings()
    assert warning
    assert hovering.controller.take_warnings() == []

    # A valid odometry of the same stamp is accepted, and the state is unchanged.
    tick = hovering.tick()
    assert tick.stats.source == "mpc"
    assert tick.stats.rejected_inputs == 1
    assert_allclose(spy.odometries[-1].p_WB, [0.0, 0.0, 2.0])


def test_bad_odometry_does_not_reset_the_timeout(hovering: Hovering) -> None:
    hovering.tick()
    sources = []
    for _ in range(30):
        hovering.reference()
        assert hovering.odometry(p_WB=np.full(3, math.nan)) is None
        tick = hovering.watch()
        sources.append(tick.stats.source if tick else "")
        hovering.sleep()
    assert sources[0] == ""
    assert "mpc" in sources  # which predicts without odometry, for a while
    assert sources[-1] == "blind"


@pytest.mark.parametrize("name", ["p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W"])
def test_a_bad_reference_is_ignored_and_the_last_good_one_kept(
    hovering: Hovering, spy: SolverSpy, make_window: MakeWindow, name: str
) -> None:
    hovering.tick()
    numbers = np.array(getattr(make_window(0), name))
    numbers[0, 0] = math.nan
    assert hovering.reference(**{name: numbers}) is None
    tick = hovering.odometry()
    assert tick is not None
    assert_sound(tick, hovering.controller.config)
    assert tick.stats.source == "mpc"
    assert tick.stats.rejected_inputs == 1


def test_huge_position_never_commands(hovering: Hovering) -> None:
    """A finite position is not rejected, but no valid command follows from it."""
    good = hovering.tick(p_WB=np.array([0.5, 0.0, 1.5]))
    assert good.stats.source == "mpc"
    for size in (1e31, 1e300):
        tick = hovering.odometry(p_WB=np.array([size, 0.0, 2.0]))
        hovering.sleep()
        assert tick is None or tick.stats.source != "mpc"
    assert hovering.tick().stats.source == "mpc"


# --- rates


def commands_of(
    controller: Controller,
    stamps: list[int],
    make_odometry: MakeOdometry,
    make_window: MakeWindow,
) -> list[int]:
    """Return the stamps that were answered with a command."""
    answered = []
    for stamp in stamps:
        controller.receive_reference(make_window(stamp), now_ns=stamp)
        tick = controller.receive_odometry(make_odometry(stamp), now_ns=stamp)
        if tick is not None and tick.command is not None:
            answered.append(stamp)
    return answered


@pytest.mark.parametrize("rate", [60, 100, 333, 1000])
def test_faster_odometry_is_decimated_to_the_control_rate(
    paper_config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow, rate: int
) -> None:
    stamps = [START + round(k * SECOND / rate) for k in range(4 * rate)]
    answered = commands_of(Controller(paper_config), stamps, make_odometry, make_window)
    assert len(answered) == pytest.approx(200, abs=1)
    for second in range(4):
        inside = [s for s in answered if 0 <= s - START - second * SECOND < SECOND]
        assert len(inside) == pytest.approx(50, abs=1)
    gaps = np.diff(answered)
    assert gaps.max() <= 2 * SECOND / max(rate, 100) + PERIOD


@pytest.mark.parametrize("seed", range(3))
def test_every_odometry_at_the_control_rate_is_answered_despite_jitter(
    paper_config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow, seed: int
) -> None:
    jitter = np.random.default_rng(seed).integers(-2 * MS, 2 * MS, size=200)
    stamps = [START + k * PERIOD + int(jitter[k]) for k in range(200)]
    answered = commands_of(Controller(paper_config), stamps, make_odometry, make_window)
    assert answered == stamps


# --- the safety ladder, driven as the node drives it


def test_a_failing_solver_flies_the_last_plan_then_hovers_then_recovers(
    hovering: Hovering, spy: SolverSpy
) -> None:
    good = hovering.tick(p_WB=np.array([0.3, -0.2, 1.5]))
    assert good.plan is not None
    inputs = good.plan.inputs
    assert not np.allclose(inputs[3], inputs[4], atol=0.05)
    spy.failing = True
    sources = []
    for count in range(1, 16):
        tick = hovering.tick(p_WB=np.array([0.3, -0.2, 1.5]))
        sources.append(tick.stats.source)
        assert_sound(tick, hovering.controller.config)
        assert tick.plan is None
        assert tick.stats.reason == "solver: made to fail"
        assert tick.stats.solver_failures == tick.stats.fallbacks == count
        if tick.stats.source == "plan":
            # Shifted: the mean of the inputs planned for the 20 ms from now on.
            assert tick.command is not None
            milliseconds = 20.0 * count + np.arange(0.25, 20.0, 0.5)
            steps = (milliseconds / 1e3 // good.plan.input_step).astype(int)
            planned = inputs[steps].mean(axis=0)
            assert_allclose(tick.command.throttle, planned[0], atol=1e-12)
            assert_allclose(tick.command.w_WB_B, planned[1:], atol=1e-12)
    assert sources == ["plan"] * 10 + ["hover"] * 5
    spy.failing = False
    assert [hovering.tick().stats.source for _ in range(3)] == ["mpc"] * 3


def test_lost_odometry_levels_then_falls_silent_then_recovers(hovering: Hovering) -> None:
    tilted = Rotation.from_euler("x", 0.5).as_quat()
    for _ in range(3):
        hovering.tick(q_WB_xyzw=tilted)
    last = hovering.now - PERIOD
    ticks: dict[int, Tick] = {}
    for _ in range(100):
        hovering.reference()
        tick = hovering.watch()
        if tick is not None:
            ticks[(hovering.now - last) // MS] = tick
        hovering.sleep()
    sources = {at: tick.stats.source for at, tick in ticks.items()}
    assert sources == {
        **dict.fromkeys(range(120, 401, 20), "mpc"),
        **dict.fromkeys(range(420, 1421, 20), "blind"),
        **dict.fromkeys(range(1440, 2001, 20), "silent"),
    }
    for at, tick in ticks.items():
        if sources[at] == "silent":
            assert tick.command is None
            assert "old" in tick.stats.reason
        else:
            assert_sound(tick, hovering.controller.config)
    throttles = [ticks[at].command.throttle for at in sources if sources[at] == "blind"]  # type: ignore[union-attr]
    assert (np.diff(throttles) < 0.0).all()
    settled = ticks[1400].command
    assert settled is not None
    assert_allclose(settled.w_WB_B, np.zeros(3), atol=1e-2)

    assert hovering.tick().stats.source == "mpc"
    assert hovering.watch() is None


def test_hover_holds_the_position_at_each_engagement(hovering: Hovering, spy: SolverSpy) -> None:
    for place in (np.array([0.0, 0.0, 2.0]), np.array([5.0, 0.0, 2.0])):
        spy.failing = False
        hovering.tick(p_WB=place)
        spy.failing = True
        ticks = [hovering.tick(p_WB=place) for _ in range(15)]
        assert ticks[-1].stats.source == "hover"
        assert ticks[-1].command is not None
        assert_allclose(ticks[-1].command.w_WB_B, np.zeros(3), atol=1e-9)


# --- lockstep


@pytest.fixture
def lockstep(
    paper_config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow
) -> Hovering:
    config = dataclasses.replace(paper_config, lockstep=True)
    return Hovering(config, make_odometry, make_window)


def test_lockstep_waits_for_the_reference_of_the_same_stamp(
    lockstep: Hovering, spy: SolverSpy
) -> None:
    assert lockstep.odometry() is None
    assert lockstep.reference(stamp_ns=START - PERIOD) is None
    assert spy.odometries == []
    tick = lockstep.reference()
    assert tick is not None
    assert tick.command is not None
    assert tick.command.stamp_ns == START


def test_lockstep_answers_a_repetition_identically_without_solving_again(
    lockstep: Hovering, spy: SolverSpy
) -> None:
    first = lockstep.tick(p_WB=np.array([0.2, 0.0, 1.0]))
    lockstep.now = START
    for _ in range(3):
        assert lockstep.odometry(p_WB=np.array([0.2, 0.0, 1.0])) is first
        assert lockstep.reference() is None
    assert len(spy.odometries) == 1
    assert first.stats.commands == 1


def test_lockstep_answers_every_odometry_regardless_of_the_wall_clock(
    paper_config: MpcConfig, make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    controller = Controller(dataclasses.replace(paper_config, lockstep=True))
    for k in range(50):
        stamp, wall = START + k * 5 * MS, k * 3600 * SECOND
        controller.receive_reference(make_window(stamp), now_ns=wall)
        tick = controller.receive_odometry(make_odometry(stamp), now_ns=wall)
        assert tick is not None
        assert tick.stats.source == "mpc"
        assert controller.watch(now_ns=wall + 1800 * SECOND) is None


# --- twist frames


def replayed(
    flight: list[LoopStep], config: MpcConfig, *, in_world: bool
) -> tuple[list[Tick], list[str]]:
    controller, ticks, warnings = Controller(config), [], []
    for step in flight:
        odometry = step.odometry
        if in_world:
            rotation = Rotation.from_quat(odometry.q_WB_xyzw)
            odometry = dataclasses.replace(
                odometry,
                v_WB_B=rotation.apply(odometry.v_WB_B),
                w_WB_B=rotation.apply(odometry.w_WB_B),
            )
        now = odometry.stamp_ns
        controller.receive_reference(step.window, now_ns=now)
        tick = controller.receive_odometry(odometry, now_ns=now)
        assert tick is not None
        ticks.append(tick)
        warnings += controller.take_warnings()
    return ticks, warnings


def world_twist(config: MpcConfig) -> MpcConfig:
    return dataclasses.replace(config, odometry=OdometryParameters(twist_frame="world"))


def test_a_world_frame_twist_flies_identically(
    paper_flight: list[LoopStep], paper_config: MpcConfig
) -> None:
    ticks, warnings = replayed(paper_flight, world_twist(paper_config), in_world=True)
    assert warnings == []
    for step, tick in zip(paper_flight, ticks, strict=True):
        assert step.tick is not None
        assert step.tick.command is not None
        assert tick.command is not None
        assert tick.command.throttle == pytest.approx(step.tick.command.throttle, abs=1e-6)
        assert_allclose(tick.command.w_WB_B, step.tick.command.w_WB_B, rtol=0.0, atol=1e-5)


# --- live parameters and bounds


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    distance=st.floats(0.0, 1e3),
    speed=st.floats(0.0, 1e2),
    fast=st.booleans(),
)
def test_commands_are_finite_and_inside_the_bounds_from_any_state(
    paper_config: MpcConfig,
    make_odometry: MakeOdometry,
    make_window: MakeWindow,
    seed: int,
    distance: float,
    speed: float,
    fast: bool,
) -> None:
    rng = np.random.default_rng(seed)
    config = dataclasses.replace(
        paper_config, throttle_min=0.05, throttle_max=0.9, omega_max=(8.0, 6.0, 2.0)
    )
    flight = Hovering(config, make_odometry, make_window)
    flight.tick()
    for _ in range(4):
        if fast:
            flight.reference(
                v_WB_W=rng.normal(scale=20.0, size=(2, 3)),
                a_WB_W=rng.normal(scale=20.0, size=(2, 3)),
                w_WB_W=rng.normal(scale=10.0, size=(2, 3)),
            )
        else:
            flight.reference()
        q = rng.normal(size=4)
        tick = flight.odometry(
            p_WB=distance * rng.normal(size=3),
            q_WB_xyzw=q / np.linalg.norm(q),
            v_WB_B=speed * rng.normal(size=3),
            w_WB_B=rng.normal(scale=10.0, size=3),
        )
        flight.sleep()
        assert tick is not None
        assert_sound(tick, config)


@pytest.mark.parametrize("rate", [2, 10, 30, 50])
def test_warns_once_of_odometry_slower_than_the_control_rate(
    rate: int, make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    controller = Controller(MpcConfig())
    controller.receive_reference(make_window(START), now_ns=START)
    warnings = []
    for count in range(4 * rate):
        now_ns = START + count * SECOND // rate
        controller.receive_odometry(make_odometry(now_ns), now_ns=now_ns)
        warnings += [each for each in controller.take_warnings() if "times a second" in each]
    warning = f"odometry arrives {rate}.0 times a second, control_rate is 50: commands are limited"
    assert [each.startswith(warning) for each in warnings] == ([True] if rate < 50 else [])
    assert all(("odom_timeout is 0.1 s" in each) == (rate <= 10) for each in warnings)
