"""Positions that jump are not chased; noise, small steps and announced ones are flown as ever."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.position_jumps import PositionJumps
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

SECOND = 1_000_000_000
Where = Callable[[float], Array]
FAR = np.array([30.0, 0.0, 0.0])


def straight(seconds: float) -> Array:
    return np.array([2.0 * seconds, 0.0, 1.0])


class Source:
    """Odometry of a vehicle that flies straight at 2 m/s, with an offset of its positions."""

    def __init__(self, rate: float = 50.0) -> None:
        self.jumps = PositionJumps()
        self._period = 1.0 / rate
        self.time = 0.0

    def see(self, seconds: float, offset: Where | None = None) -> list[Array]:
        """Return by how much the position believed is off the true one, each time."""
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
def test_a_jump_to_and_fro_is_never_believed(rate: float) -> None:
    source = Source(rate)
    assert np.abs(source.see(20.0, flips(2.0))).max() < 1e-6


def test_a_place_that_lasts_is_taken_after_three_seconds() -> None:
    source = Source()
    source.see(2.0)
    off = np.linalg.norm(source.see(4.0, lambda _: FAR), axis=1)
    taken = int(np.argmax(off > 1.0))
    assert taken * 0.02 == pytest.approx(3.0, abs=0.05)
    assert off[taken - 1] < 1e-6 and off[-1] == pytest.approx(30.0)
    (note,) = source.jumps.take_notes()
    assert "30.0 m aside has lasted for 3.0 s: taken" in note


def test_a_step_back_is_taken_at_once_and_another_one_later() -> None:
    source = Source()
    source.see(2.0)
    source.see(4.0, lambda _: FAR)
    assert np.abs(source.see(0.1)).max() < 1e-6
    assert np.abs(source.see(8.0, lambda _: FAR)).max() < 1e-6
    assert np.linalg.norm(source.see(2.0, lambda _: FAR)[-1]) == pytest.approx(30.0)


def test_places_that_do_not_agree_are_not_taken() -> None:
    source = Source()
    source.see(2.0)
    assert np.abs(source.see(8.0, lambda seconds: FAR * (1.0 + seconds // 1.0))).max() < 1e-6


def test_says_at_once_what_jumped() -> None:
    source = Source()
    source.see(2.0)
    source.see(0.02, lambda _: FAR)
    assert "position jumped by 30.0 m" in source.jumps.fault
    source.see(0.02)
    assert source.jumps.fault == ""


@pytest.mark.parametrize("step", [0.1, 0.5, 0.7])
def test_a_small_step_is_flown_at_once(step: float) -> None:
    source = Source()
    source.see(2.0)
    off = source.see(0.02, lambda _: np.array([0.0, step, 0.0]))
    assert off[0][1] == pytest.approx(step)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    deviation=st.sampled_from([0.01, 0.1, 0.5, 2.0]),
    rate=st.sampled_from([10.0, 50.0, 200.0]),
)
def test_ordinary_noise_is_never_refused(seed: int, deviation: float, rate: float) -> None:
    random, source = np.random.default_rng(seed), Source(rate)
    given = [random.normal(scale=deviation, size=3) for _ in range(round(20.0 * rate) + 1)]
    source.see(20.0, lambda seconds: given[min(round(seconds * rate), len(given) - 1)])
    assert source.jumps.take_notes() == []


def test_a_gap_allows_for_what_may_have_happened_in_it() -> None:
    source = Source()
    source.see(2.0)
    source.time += 0.5
    off = source.see(0.02, lambda _: np.array([0.0, 2.5, 0.0]))
    assert off[0][1] == pytest.approx(2.5)


@pytest.mark.parametrize("order", ["before", "after"])
def test_an_announced_step_is_taken_at_once(order: str) -> None:
    """Also when it is announced after the first odometry in the new coordinates."""
    source = Source()
    source.see(2.0)
    reset = EstimateReset(stamp_ns=round(2.02 * SECOND), turn=0.0, step_W=FAR)
    if order == "before":
        source.jumps.reset_estimate(reset)
        off = source.see(0.5, lambda _: FAR)
        assert np.linalg.norm(off[0]) == pytest.approx(30.0)
    else:
        source.see(0.02, lambda _: FAR)
        source.jumps.reset_estimate(reset)
        off = source.see(0.5, lambda _: FAR)
    assert np.linalg.norm(off, axis=1) == pytest.approx(30.0)


def test_while_commands_do_not_act_every_place_is_taken() -> None:
    source = Source()
    source.see(2.0)
    source.jumps.engage(False)
    assert np.linalg.norm(source.see(0.02, lambda _: FAR)[0]) == pytest.approx(30.0)


def flown(offset: Where) -> tuple[Array, list[CommandSample], set[str], list[str]]:
    """Hover with an offset of the positions told: distances from where, commands, reasons, log."""
    mpc = MpcConfig(lockstep=False)
    controller, begin_ns = Controller(mpc), 0
    commands: list[CommandSample] = []
    reasons, log = set(), []

    def law(odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        nonlocal begin_ns
        begin_ns = begin_ns or odometry.stamp_ns
        seconds = 1e-9 * (odometry.stamp_ns - begin_ns)
        told = dataclasses.replace(odometry, p_WB=odometry.p_WB + offset(seconds))
        tick = controller.step(told, window)
        log.extend(controller.take_warnings())
        if tick is None or tick.command is None:
            return None
        reasons.add(f"{tick.stats.source} {tick.stats.reason}")
        commands.append(tick.command)
        return tick.command

    simulator = SimulatorConfig(
        initial_position=(0.0, 0.0, 2.0), initial_throttle=0.3, duration=10.0
    )
    reference = ReferenceConfig(trajectory="hover", height=2.0)
    steps = list(fly(simulator=simulator, controller=law, reference=reference))
    p_WB = np.array([step.truth.p_WB for step in steps])
    return np.linalg.norm(p_WB - [0.0, 0.0, 2.0], axis=1), commands, reasons, log


def test_a_flight_is_not_disturbed_by_a_position_that_jumps_by_30_m() -> None:
    far, commands, reasons, log = flown(flips(2.0))
    assert far.max() < 0.05
    assert max(command.throttle for command in commands) < 0.35
    assert max(np.abs(command.w_WB_B).max() for command in commands) < 0.5
    assert any(reason.startswith("mpc position jumped by 30.0 m") for reason in reasons)
    assert "position jumped by 30.0 m" in log[0]
