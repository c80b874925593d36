# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator, a stack that speaks its own messages and keeps its own rules, bridge, and MPC.

All in one process, with stand-ins for messages of packages that are not there; with those of the
stacks themselves, over DDS: ``test/installed/test_bridges.py``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fixtures.bridged_flight import DURATION, Bridged, Direct, Flight, fly
from fixtures.fake_stacks import CASES, SECOND, FakePx4, New, SpoolingPx4

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS


def bridged(case: str, new: New) -> Bridged:
    bridge, stack, parameters, _ = CASES[case]
    return Bridged(bridge(bridge.Config(**parameters), new), stack(new))


@pytest.mark.parametrize("case", list(CASES))
def test_the_square_is_flown_as_well_as_without_the_bridge(case: str, new: New) -> None:
    way = bridged(case, new)
    _, stack, _, throttle_max = CASES[case]
    flight = fly(way, odom_rate=stack.odom_rate, throttle_max=throttle_max)
    plain = fly(Direct(flight.acting_ns), odom_rate=stack.odom_rate, throttle_max=throttle_max)

    assert len(flight.errors) > 0.6 * DURATION * stack.odom_rate
    assert flight.sources == {Source.MPC}
    assert plain.acting_ns == flight.acting_ns
    assert flight.rmse <= 1.05 * plain.rmse
    assert way.bridge.take_warnings() == []
    assert way.bridge.jumps == 0


def test_disarmed_commands_do_not_disturb_the_estimate(new: New) -> None:
    """Asked to climb a little, the vehicle stays on the ground: not for lack of thrust."""
    way = bridged("px4", new)
    way.stack = SpoolingPx4(new)
    flight = fly(
        way,
        odom_rate=way.stack.odom_rate,
        throttle_max=0.9,
        ground_time_ns=10 * SECOND,
        duration=18.0,
        reference=ReferenceConfig(trajectory="hover", height=0.5, takeoff_height=0.5),
    )
    assert len(flight.thrust_scales) > 13.0 * min(way.stack.odom_rate, 50.0)
    assert flight.sources == {Source.MPC}
    assert max(abs(scale - 1.0) for scale in flight.thrust_scales) < 0.01
    # The depth at which the reference rests, and what it rises while the motors spool up.
    assert max(flight.errors) <= 0.55
    assert max(flight.errors[-50:]) <= 0.005


def test_flight_continues_after_an_estimator_reset(new: New) -> None:
    way = bridged("px4", new)
    stack = way.stack
    assert isinstance(stack, FakePx4)

    def reset(now_ns: int) -> None:
        if now_ns == SIMULATION_START_NS + 5 * SECOND:
            stack.reset_counter += 1
            stack.offset_ned = np.array([1.0, -0.5, 0.0])

    flight = fly(way, odom_rate=100.0, at=reset)
    tick = flight.controller._last_tick
    assert way.bridge.jumps == 1
    assert way.bridge.take_warnings() == [
        "the odometry jumps by 1.12 m (reset_counter 0 to 1, pose_frame 1 to 1)"
    ]
    (step,) = flight.resets
    assert np.allclose(step.step_W, [-0.5, 1.0, 0.0], atol=0.01)  # ENU
    assert abs(step.turn) < 0.01
    assert flight.sources == {Source.MPC}
    assert tick is not None
    assert tick.stats.rejected_inputs == 0
    # Where the estimator says that the square is, it is flown: shifted by the reset.
    assert max(flight.errors) < 3.1


LEMNISCATE = ReferenceConfig(trajectory="lemniscate", amplitude_x=3.0, angular_frequency=0.8)
DISTURBED_NS = SIMULATION_START_NS + 9 * SECOND


def flown_about(new: New, disturb: Callable[[Bridged], None]) -> tuple[Flight, Array]:
    """Fly the lemniscate behind PX4, disturbed once; return the errors (n,) [m] from then on."""
    way = bridged("px4", new)

    def at(now_ns: int) -> None:
        if now_ns == DISTURBED_NS:
            disturb(way)

    flight = fly(way, odom_rate=100.0, duration=13.0, reference=LEMNISCATE, at=at)
    assert flight.acting_ns
    return flight, np.array(flight.errors[(DISTURBED_NS - flight.acting_ns) // (SECOND // 100) :])


@pytest.fixture(scope="module")
def undisturbed(new: New) -> Array:
    """Return the errors (n,) [m] of the flight without a disturbance."""
    return flown_about(new, lambda way: None)[1]


def test_stack_clock_step_changes_no_command(undisturbed: Array, new: New) -> None:
    def set_clock(way: Bridged) -> None:
        assert isinstance(way.stack, FakePx4)
        way.stack.clock_ns = -3 * SECOND

    flight, errors = flown_about(new, set_clock)
    assert flight.sources == {Source.MPC}
    assert errors.max() < undisturbed.max() + 0.05


def test_predicts_over_a_link_that_stalls_for_three_tenths_of_a_second(
    undisturbed: Array, new: New
) -> None:
    """The delayed messages arrive at once, late by their stamps; the MPC flies all the time."""

    def stall(way: Bridged) -> None:
        way.held_until_ns = DISTURBED_NS + 3 * SECOND // 10

    flight, errors = flown_about(new, stall)
    assert errors.max() < undisturbed.max() + 0.05
    assert errors[-100:].max() < undisturbed[-100:].max() + 0.01
    assert flight.sources == {Source.MPC}
