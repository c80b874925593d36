# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of one's own inside checks, limits and failsafe: what they get, and their errors."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
import pytest
from fixtures.windows import window_through
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros import (
    CommandSample,
    Controller,
    Flight,
    MpcConfig,
    OdometrySample,
    ReferenceConfig,
    ReferenceWindow,
    simulate,
    summarise,
)
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.extras.controllers.law_stage import law_planner, window_from
from quad_mpc_ros.extras.controllers.registry import configured_law
from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

CONFIG = MpcConfig(lockstep=True)
HOVER = ReferenceConfig(trajectory="hover")
VEHICLE = CONFIG.vehicle()


class Climb:
    """Commands a little more than the hover throttle, and records its calls."""

    def __init__(self, config: MpcConfig | None = None) -> None:
        self.resets = 0
        self.steps: list[tuple[OdometrySample, ReferenceWindow]] = []

    def reset(self) -> None:
        self.resets += 1

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> Any:
        self.steps.append((odometry, reference))
        error = float(reference.p_WB[0, 2] - odometry.p_WB[2])
        thrust = VEHICLE.mass * (9.81 + 2.0 * error - 3.0 * float(odometry.v_WB_B[2]))
        return self.command(odometry, VEHICLE.nearest_throttle(thrust))

    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        return CommandSample(
            stamp_ns=odometry.stamp_ns, throttle=throttle, w_WB_B=np.array([0.0, 0.0, 0.1])
        )


class Raises(Climb):
    """Fails after one second."""

    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        if len(self.steps) == 50:
            raise RuntimeError("out of\nideas")
        return super().command(odometry, throttle)


class Tuple(Climb):
    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        if len(self.steps) == 50:
            return throttle, 0.0, 0.0, 0.0
        return super().command(odometry, throttle)


class Nothing(Climb):
    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        return None


class Shape(Climb):
    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        return dataclasses.replace(super().command(odometry, throttle), w_WB_B=np.zeros(2))


class Infinite(Climb):
    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        return dataclasses.replace(super().command(odometry, throttle), throttle=np.nan)


class Late(Climb):
    """Works for 30 ms once a second."""

    def command(self, odometry: OdometrySample, throttle: float) -> Any:
        if len(self.steps) % 50 == 40:
            until = time.thread_time() + 0.03
            while time.thread_time() < until:
                pass
        return super().command(odometry, throttle)


class WithoutReset:
    def __init__(self, config: MpcConfig) -> None:
        pass


class Unbuildable(Climb):
    def __init__(self, config: MpcConfig) -> None:
        raise KeyError("gain")


def flown(law: Any, duration: float = 2.0) -> Flight:
    return simulate(CONFIG, reference=HOVER, controller=law, duration=duration)


def test_a_controller_flies_with_window_at_its_odometry_and_recorded_step_times() -> None:
    law = Climb()
    flight, summary = flown(law, 6.0), summarise(flown(law, 6.0))
    assert law.resets == 2  # once for each flight
    for odometry, window in law.steps:
        assert window.stamp_ns + int(window.offset_ns[0]) == odometry.stamp_ns
    assert abs(flight.p_WB[-1, 2] - 2.0) < 0.1
    assert set(flight.stats["source"]) == {"mpc"}
    assert 0.0 < summary["solve_time_us"]["p50"] < summary["step_time_us"]["p50"]
    assert summary["config"]["mpc"]["controller"].endswith("test_law_stage:Climb")
    assert verdict_on(summary).good
    assert "Climb sent all 300 commands" in verdict_on(summary).line


def test_commands_are_within_the_limits_of_the_configuration() -> None:
    class Wild(Climb):
        def command(self, odometry: OdometrySample, throttle: float) -> Any:
            return CommandSample(stamp_ns=0, throttle=7.0, w_WB_B=np.full(3, 99.0))

    for step in fly(
        mpc=CONFIG, simulator=SimulatorConfig(duration=0.5), reference=HOVER, controller=Wild()
    ):
        assert step.command is not None and step.command.stamp_ns == step.odometry.stamp_ns
        assert step.command.throttle <= CONFIG.throttle_max
        assert np.all(np.abs(step.command.w_WB_B) <= CONFIG.omega_max)


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        (Raises(), "error in the controller: RuntimeError: out of ideas"),
        (Tuple(), "command: given [0."),
        (Nothing(), "command: given None, expected CommandSample"),
        (Shape(), "w_WB_B: given "),
        (Infinite(), "throttle: given nan, expected a finite number"),
    ],
)
def test_an_error_of_a_controller_is_a_failsafe_until_it_is_engaged_again(
    law: Climb, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    flight = flown(law)
    assert len(caplog.records) == 1 and reason in caplog.text
    failed = flight.stats["source"] != "mpc"
    calls = len(law.steps)
    assert failed.any() and failed[failed.argmax() :].all()
    assert calls == 1 + failed.argmax()  # not called again
    verdict = verdict_on(summarise(flight))
    assert reason in verdict.line and not verdict.good
    assert any("your_controller.md" in each for each in verdict.advice)


def test_a_function_is_a_controller_with_checks_limits_and_failsafe(
    caplog: pytest.LogCaptureFixture,
) -> None:
    flight = flown(Climb().step)
    assert set(flight.stats["source"]) == {"mpc"} and not caplog.records
    failed = flown(Infinite().step)
    assert "mpc" not in failed.stats["source"]
    assert len(caplog.records) == 1
    assert ":Climb.step: error in the controller: ArgumentError: throttle" in caplog.text


def test_a_failed_controller_flies_again_after_engagement() -> None:
    law = Raises()
    controller = Controller(CONFIG, planner=law_planner(CONFIG, law))

    def tick(k: int) -> Any:
        stamp_ns = k * 20_000_000
        odometry = OdometrySample.at_rest([0.0, 0.0, 1.0], stamp_ns=stamp_ns)
        return controller.step(odometry, ReferenceWindow.hover([0, 0, 1.0], stamp_ns=stamp_ns))

    sources = [tick(k).decision.source for k in range(60)]
    assert sources[:49] == [Source.MPC] * 49 and Source.MPC not in sources[49:]
    controller.engage(False)
    controller.engage(True)
    assert tick(60).decision.source is Source.MPC and law.resets == 2


def test_a_late_command_is_dropped_and_counted() -> None:
    flight = flown(Late())
    late = ["late: the controller took 3" in reason for reason in flight.stats["reason"]]
    assert np.flatnonzero(late).tolist() == [39, 89]
    assert not np.any(flight.stats["source"][late] == "mpc")
    assert not verdict_on(summarise(flight)).good


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nosuch", "given 'nosuch', expected one of mpc, geometric, px4, lqr"),
        ("no.such:Class", "no.such:Class cannot be imported: ModuleNotFoundError"),
        (f"{__name__}:Missing", "cannot be imported"),
        ("json:JSONDecoder", "cannot be created: TypeError"),
    ],
)
def test_an_unusable_name_is_reported_with_the_names(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        configured_law(dataclasses.replace(CONFIG, controller=name))


def test_a_window_starts_at_any_time_with_the_interpolated_reference() -> None:
    seconds = np.linspace(0.0, 1.0, 11)
    circle = np.column_stack((np.cos(seconds), np.sin(seconds), np.full(11, 2.0)))
    window = window_through(seconds, circle, stamp_ns=5_000_000_000)
    assert window_from(window, 5_000_000_000) is window
    later = window_from(window, 5_250_000_000)
    assert later.stamp_ns == 5_250_000_000
    assert_array_equal(later.offset_ns, np.r_[0, np.arange(1, 9) * 100_000_000 - 50_000_000])
    assert_array_equal(later.p_WB[1:], window.p_WB[3:])
    assert_allclose(later.p_WB[0], [np.cos(0.25), np.sin(0.25), 2.0], atol=2e-3)
    assert_allclose(np.linalg.norm(later.v_WB_W[0]), 1.0, atol=0.05)
    beyond = window_from(window, 7_000_000_000)
    assert len(beyond.p_WB) == 1 and not beyond.v_WB_W.any()
