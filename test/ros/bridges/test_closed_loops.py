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
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.velocity import VelocityCommand
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


@pytest.mark.parametrize("case", list(CASES))
def test_silent_at_once_when_the_mpc_dies_or_repeats_itself(case: str, new: New) -> None:
    way = bridged(case, new)
    stack = CASES[case][1]
    last: list[CommandSample] = []
    through = way.command

    def remembering(command: CommandSample, now_ns: int) -> CommandSample | None:
        last[:] = [command]
        return through(command, now_ns)

    way.command = remembering  # type: ignore[method-assign]
    fly(way, odom_rate=stack.odom_rate, duration=3.2)
    died_ns = way.sent_ns[-1]

    # A process that hangs may still repeat itself.
    for elapsed_ns in range(0, SECOND, SECOND // 50):
        way.bridge.receive_command(last[0], now_ns=died_ns + elapsed_ns)
        if way.bridge.silence == "":
            way.sent_ns.append(died_ns + elapsed_ns)

    assert way.sent_ns[-1] - died_ns <= SECOND // 10
    assert "old" in way.bridge.silence


@pytest.mark.parametrize("case", ["px4", "mavros with px4", "crazyswarm2"])
def test_disarmed_commands_do_not_disturb_the_estimate(case: str, new: New) -> None:
    """Asked to climb a little, the vehicle stays on the ground: not for lack of thrust."""
    way = bridged(case, new)
    if case == "px4":
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


def test_a_reset_of_the_estimator_is_flown_on_from(new: New) -> None:
    way = bridged("px4", new)
    stack = way.stack
    assert isinstance(stack, FakePx4)

    announced = []

    def reset(now_ns: int) -> None:
        if way.bridge.announced_reset is not None:
            announced.append(way.bridge.announced_reset)
        if now_ns == SIMULATION_START_NS + 5 * SECOND:
            stack.reset_counter += 1
            stack.offset_ned = np.array([1.0, -0.5, 0.0])

    flight = fly(way, odom_rate=100.0, at=reset)
    tick = flight.controller._last_tick
    assert way.bridge.jumps == 1
    assert way.bridge.take_warnings() == [
        "the estimate steps by 1.12 m (reset_counter 0 to 1, pose_frame 1 to 1)"
    ]
    (step,) = announced
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


@pytest.mark.parametrize("step", [3, -3])
def test_stack_clock_step_changes_no_command(step: int, new: New) -> None:
    _, undisturbed = flown_about(new, lambda way: None)

    def set_clock(way: Bridged) -> None:
        assert isinstance(way.stack, FakePx4)
        way.stack.clock_ns = step * SECOND

    flight, errors = flown_about(new, set_clock)
    assert flight.sources == {Source.MPC}
    assert errors.max() < undisturbed.max() + 0.05


def test_a_link_that_stalls_for_three_tenths_of_a_second_is_foreseen(new: New) -> None:
    """All that it held up comes at once, late by its stamps; the MPC flies all the time."""
    _, undisturbed = flown_about(new, lambda way: None)

    def stall(way: Bridged) -> None:
        way.held_until_ns = DISTURBED_NS + 3 * SECOND // 10

    flight, errors = flown_about(new, stall)
    assert errors.max() < undisturbed.max() + 0.05
    assert errors[-100:].max() < undisturbed[-100:].max() + 0.01
    assert flight.sources == {Source.MPC}


def test_sends_px4_nothing_without_status(new: New) -> None:
    way = bridged("px4", new)
    stack = way.stack
    assert isinstance(stack, FakePx4)

    def lose(now_ns: int) -> None:
        stack.status_speaks = now_ns < SIMULATION_START_NS + 4 * SECOND

    with pytest.raises(AssertionError, match="setpoints timed out"):
        fly(way, odom_rate=100.0, at=lose)
    assert "no vehicle_status within 1.5 s" in way.bridge.silence


class ByHand:
    """Takes off, pushes the stick for two seconds, lets it go, and lands."""

    def __init__(self) -> None:
        self.modes: list[str] = []
        self.speeds: list[float] = []
        self.ends: dict[str, Array] = {}
        self.early: list[bool] = []
        self._pushed_ns = 0

    def __call__(self, live: LiveReference, now_ns: int) -> None:
        mode = live.mode(now_ns)
        if not self.modes or mode != self.modes[-1]:
            self.modes.append(mode)
        push = VelocityCommand(
            velocity=np.array([1.0, 0.5, 0.0]), yaw_rate=0.5, heading_aligned=True
        )
        if mode in ("waiting", "ground"):
            refused = live.move(now_ns, push)
            self.early.append(refused is not None and refused.accepted)
        if mode == "ground" and "landing" not in self.modes:
            live.take_off(now_ns)
        elif mode == "hold" and not self._pushed_ns:
            self._pushed_ns = now_ns
        elif mode == "hold" and self.modes[-2] == "velocity":
            live.land(now_ns)
        window = live.window(now_ns)
        assert window is not None
        if self._pushed_ns and now_ns - self._pushed_ns < 2 * SECOND:
            live.move(now_ns, push)
            self.speeds.append(float(np.linalg.norm(window.v_WB_W[0])))
        self.ends[mode] = window.p_WB[0]


@pytest.mark.parametrize("case", ["px4", "crazyswarm2", "rosflight"])
def test_velocities_are_flown_from_the_ground_to_the_ground(case: str, new: New) -> None:
    pilot = ByHand()
    flight = fly(
        bridged(case, new),
        odom_rate=CASES[case][1].odom_rate,
        throttle_max=CASES[case][3],
        duration=19.0,
        reference=ReferenceConfig(mode="on_request", takeoff_height=1.0),
        pilot=pilot,
    )
    assert not any(pilot.early)
    assert pilot.modes[-6:] == ["takeoff", "hold", "velocity", "hold", "landing", "ground"]
    assert flight.sources == {Source.MPC}
    assert pilot.speeds[-1] == pytest.approx(np.hypot(1.0, 0.5), abs=1e-3)
    travelled = float(np.linalg.norm(pilot.ends["hold"][:2]))
    assert 1.5 < travelled < 3.5
    airborne = flight.errors[: -3 * round(CASES[case][1].odom_rate)]
    assert max(airborne[len(airborne) // 2 :]) < 0.55  # half a metre below it on the ground
