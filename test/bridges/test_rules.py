"""What every bridge obeys, and what single stacks ask for besides."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.bridges.aerostack2 import Aerostack2Bridge
from quad_mpc_ros.bridges.bridge import Bridge, OutgoingMessage
from quad_mpc_ros.bridges.crazyswarm2 import Crazyswarm2Bridge
from quad_mpc_ros.bridges.mavros import MavrosBridge
from quad_mpc_ros.bridges.odometry import OdometryStamps
from quad_mpc_ros.bridges.px4 import Px4Bridge
from quad_mpc_ros.bridges.rates import RatesBridge
from quad_mpc_ros.bridges.rosflight import RosflightBridge
from quad_mpc_ros.model.samples import CommandSample, OdometrySample

New = Callable[[str], Any]
BRIDGES: list[type[Bridge]] = [
    Px4Bridge,
    MavrosBridge,
    RosflightBridge,
    Aerostack2Bridge,
    Crazyswarm2Bridge,
    RatesBridge,
]
SECOND = 1_000_000_000
T0 = 100 * SECOND


def command(stamp_ns: int, throttle: float = 0.3, w: float = 0.0) -> CommandSample:
    return CommandSample(stamp_ns=stamp_ns, throttle=throttle, w_WB_B=np.array([w, 0.0, 0.0]))


def topics(sendings: list[OutgoingMessage]) -> list[str]:
    return [sending.topic.name for sending in sendings]


def tell(bridge: Bridge, topic: str, message: Any, now_ns: int) -> OdometrySample | None:
    (receive,) = (each.receive for each in bridge.subscriptions if each.topic.name == topic)
    return receive(message, now_ns)


def px4(new: New, **parameters: Any) -> Px4Bridge:
    return Px4Bridge(Px4Bridge.Config(**parameters), new)


def px4_status(new: New, nav_state: int) -> Any:
    message = new("px4_msgs/msg/VehicleStatus")
    message.nav_state = nav_state
    return message


def px4_odometry(new: New, now_ns: int, **fields: Any) -> Any:
    message = new("px4_msgs/msg/VehicleOdometry")
    message.timestamp = now_ns // 1000
    message.pose_frame = message.velocity_frame = 1
    message.q = [1.0, 0.0, 0.0, 0.0]
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def ready_to_fly(kind: type[Bridge], new: New, now_ns: int) -> Bridge:
    """Return a bridge whose stack takes setpoints."""
    bridge = kind(kind.Config(), new)
    bridge.engage(True, now_ns=now_ns)
    if kind is Px4Bridge:
        tell(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, 14), now_ns)
    elif kind is MavrosBridge:
        state = new("mavros_msgs/msg/State")
        state.connected, state.mode = True, "OFFBOARD"
        tell(bridge, "/mavros/state", state, now_ns)
    elif kind is RosflightBridge:
        tell(bridge, "/status", new("rosflight_msgs/msg/Status"), now_ns)
    elif kind is Aerostack2Bridge:
        info = new("as2_msgs/msg/PlatformInfo")
        info.connected = info.offboard = True
        info.current_control_mode.control_mode = 6
        tell(bridge, "/drone0/platform/info", info, now_ns)
    return bridge


@pytest.mark.parametrize("kind", BRIDGES)
def test_passes_a_fresh_command_and_says_so(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, new, T0)
    assert bridge.receive_command(command(T0 - SECOND // 100), now_ns=T0)
    assert (bridge.silence, bridge.commands, bridge.passed) == ("", 1, 1)


@pytest.mark.parametrize("kind", BRIDGES)
@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (command(T0 - SECOND // 9), "0.111 s old"),
        (command(T0 + SECOND // 9), "-0.111 s old"),
        (command(T0, throttle=math.nan), "not finite"),
        (command(T0, w=math.inf), "not finite"),
        (command(T0, throttle=1.1), "outside"),
        (command(T0, throttle=-0.1), "outside"),
        (command(T0, w=-101.0), "101 rad/s"),
    ],
)
def test_passes_nothing_stale_or_senseless(
    kind: type[Bridge], new: New, made: CommandSample, reason: str
) -> None:
    bridge = ready_to_fly(kind, new, T0)
    assert bridge.receive_command(made, now_ns=T0) == []
    assert reason in bridge.silence


@pytest.mark.parametrize("kind", BRIDGES)
def test_says_nothing_to_a_stack_it_does_not_hear(kind: type[Bridge], new: New) -> None:
    bridge = kind(kind.Config(), new)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
    assert bridge.silence


@pytest.mark.parametrize("kind", [Px4Bridge, MavrosBridge, RosflightBridge, Aerostack2Bridge])
def test_falls_silent_when_the_stack_does(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, new, T0)
    later = T0 + 4 * SECOND
    assert bridge.receive_command(command(later), now_ns=later) == []


@pytest.mark.parametrize("kind", BRIDGES)
def test_every_topic_and_service_is_of_a_package_that_it_names(
    kind: type[Bridge], new: New
) -> None:
    bridge = kind(kind.Config(), new)
    known = {*kind.packages, "geometry_msgs", "nav_msgs", "sensor_msgs", "std_srvs"}
    named = [each.topic for each in bridge.subscriptions] + list(bridge.publications)
    types = [topic.type_name for topic in named] + [kind for _, kind in bridge.services]
    assert {type_name.split("/")[0] for type_name in types} <= known


@pytest.mark.parametrize("nav_state", [0, 2, 4, 10, 13, 15, 17, 18])
def test_px4_gets_the_heartbeat_but_no_rates_outside_of_offboard(new: New, nav_state: int) -> None:
    bridge = px4(new)
    tell(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, nav_state), T0)
    sent = bridge.receive_command(command(T0), now_ns=T0)
    assert topics(sent) == ["/fmu/in/offboard_control_mode"]
    assert "not in offboard mode" in bridge.silence


def test_px4_gets_the_heartbeat_before_the_rates(new: New) -> None:
    bridge = ready_to_fly(Px4Bridge, new, T0)
    sent = bridge.receive_command(command(T0), now_ns=T0)
    assert topics(sent) == ["/fmu/in/offboard_control_mode", "/fmu/in/vehicle_rates_setpoint"]


@pytest.mark.parametrize("wish", ["arm", "engage"])
def test_px4_is_asked_only_after_a_second_of_heartbeats(new: New, wish: str) -> None:
    bridge = px4(new)
    ask = getattr(bridge, wish)
    assert not ask(True, now_ns=T0).accepted
    assert ask(False, now_ns=T0).accepted  # away from the MPC at any time
    tell(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, 4), T0)
    accepted_after = None
    for now_ns in range(T0, T0 + 2 * SECOND, SECOND // 50):
        tell(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, 4), now_ns)
        bridge.receive_command(command(now_ns), now_ns=now_ns)
        if accepted_after is None and ask(True, now_ns=now_ns).accepted:
            accepted_after = now_ns - T0
    assert accepted_after is not None
    assert SECOND < accepted_after < 1.3 * SECOND
    # A pause, and it begins again.
    assert not ask(True, now_ns=T0 + 3 * SECOND).accepted


def test_px4_topics_end_in_the_version_of_their_message(new: New) -> None:
    def names(bridge: Px4Bridge) -> set[str]:
        return {each.topic.name for each in bridge.subscriptions} | {
            topic.name for topic in bridge.publications
        }

    assert "/fmu/out/vehicle_status_v4" in names(px4(new))
    assert "/fmu/out/vehicle_odometry" in names(px4(new))
    older = names(px4(new, fmu="/px4_1/fmu", status_version=0, rates_version=2))
    assert {"/px4_1/fmu/out/vehicle_status", "/px4_1/fmu/in/vehicle_rates_setpoint_v2"} <= older


@pytest.mark.parametrize("field", ["position", "velocity", "angular_velocity"])
def test_px4_state_marked_invalid_is_not_passed_on(new: New, field: str) -> None:
    bridge = px4(new)
    message = px4_odometry(new, T0, **{field: [math.nan, 0.0, 0.0]})
    assert tell(bridge, "/fmu/out/vehicle_odometry", message, T0) is None
    (warning,) = bridge.take_warnings()
    assert "the stack's state is not valid" in warning
    assert "not finite" in warning


def test_px4_frame_changes_are_passed_on_as_a_jump(new: New) -> None:
    bridge = px4(new)
    frames = ((1, 1), (2, 2), (2, 3))
    for i, (pose, velocity) in enumerate(frames):
        now_ns = T0 + i * SECOND // 50
        message = px4_odometry(new, now_ns, pose_frame=pose, velocity_frame=velocity)
        odometry = tell(bridge, "/fmu/out/vehicle_odometry", message, now_ns)
        assert odometry is not None
        assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert bridge.jumps == 1


def test_px4_refusals_are_told(new: New) -> None:
    bridge = px4(new)
    ack = new("px4_msgs/msg/VehicleCommandAck")
    ack.command, ack.result = 400, 1
    tell(bridge, "/fmu/out/vehicle_command_ack_v1", ack, T0)
    assert bridge.take_warnings() == ["PX4 answers command 400 with result 1"]


@pytest.mark.parametrize("kind", BRIDGES)
def test_nothing_arms_or_engages_by_itself(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, new, T0)
    spoken = {
        name
        for now_ns in range(T0, T0 + SECOND // 2, SECOND // 50)
        for name in topics(bridge.receive_command(command(now_ns), now_ns=now_ns))
    }
    assert spoken
    assert not any("vehicle_command" in name for name in spoken)


def test_ardupilot_gets_nothing_outside_of_guided(new: New) -> None:
    bridge = MavrosBridge(MavrosBridge.Config(autopilot="ardupilot"), new)
    state = new("mavros_msgs/msg/State")
    for mode, heard in (("LOITER", False), ("GUIDED", True), ("GUIDED_NOGPS", True)):
        state.connected, state.mode = True, mode
        tell(bridge, "/mavros/state", state, T0)
        assert bool(bridge.receive_command(command(T0), now_ns=T0)) is heard
    state.connected = False
    assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_rosflight_leaves_arming_and_handing_over_to_the_pilot(new: New) -> None:
    bridge = ready_to_fly(RosflightBridge, new, T0)
    assert not bridge.arm(True, now_ns=T0).accepted
    assert not bridge.engage(True, now_ns=T0).accepted


def test_a_crazyflie_is_unlocked_first_and_again_after_it_cut(new: New) -> None:
    bridge = ready_to_fly(Crazyswarm2Bridge, new, T0)

    def thrust(now_ns: int) -> float:
        (sending,) = bridge.receive_command(command(now_ns), now_ns=now_ns)
        return float(sending.message.linear.z)

    thrusts = [thrust(T0 + i * SECOND // 50) for i in range(6)]
    assert thrusts[:3] == [0.0] * 3
    assert min(thrusts[3:]) > 0.0
    # A gap in flight that the firmware bridges must not cut the motors.
    assert thrust(T0 + SECOND) > 0.0
    assert thrust(T0 + 4 * SECOND) == 0.0


@pytest.mark.parametrize("bit", [32, 64])
def test_a_crazyflie_that_tumbled_or_locked_itself_hears_nothing(new: New, bit: int) -> None:
    bridge = ready_to_fly(Crazyswarm2Bridge, new, T0)
    status = new("crazyflie_interfaces/msg/Status")
    status.supervisor_info = 2 | bit
    tell(bridge, "/cf231/status", status, T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_a_stack_is_released_at_once(new: New) -> None:
    bridge = ready_to_fly(RatesBridge, new, T0)
    bridge.engage(False, now_ns=T0)
    assert bridge.receive_command(command(T0), now_ns=T0) == []


def test_aerostack2_poses_and_twists_are_paired_by_time(new: New) -> None:
    bridge = Aerostack2Bridge(Aerostack2Bridge.Config(), new)
    pose, twist = new("geometry_msgs/msg/PoseStamped"), new("geometry_msgs/msg/TwistStamped")
    pose.pose.orientation.w, twist.header.frame_id = 1.0, "base_link"
    pose.header.stamp.sec = 100
    twist.header.stamp.sec, twist.header.stamp.nanosec = 99, 980_000_000
    names = "/drone0/self_localization/pose", "/drone0/self_localization/twist"
    assert tell(bridge, names[0], pose, T0) is None
    assert tell(bridge, names[1], twist, T0) is None
    twist.header.stamp.sec, twist.header.stamp.nanosec = 100, 0
    odometry = tell(bridge, names[1], twist, T0)
    assert odometry is not None
    assert odometry.stamp_ns == 100 * SECOND
    assert tell(bridge, names[1], twist, T0) is None  # each is used once


def test_stamps_of_another_clock_become_times_of_arrival() -> None:
    stamps = OdometryStamps(tolerance=0.1)
    assert stamps.stamp(T0 - SECOND // 50, now_ns=T0) == T0 - SECOND // 50
    assert stamps.stamp(7 * SECOND, now_ns=T0 + SECOND // 50) == T0 + SECOND // 50


def test_stamps_never_run_backwards_unless_the_clock_was_set() -> None:
    stamps = OdometryStamps(tolerance=0.1)
    assert stamps.stamp(T0, now_ns=T0) == T0
    assert stamps.stamp(T0, now_ns=T0) is None
    assert stamps.stamp(T0 - 1000, now_ns=T0) is None
    assert stamps.stamp(SECOND, now_ns=SECOND) == SECOND


def test_commands_take_the_newest_battery_into_account(new: New) -> None:
    config = Px4Bridge.Config()
    reference = dataclasses.replace(config.thrust_map, battery_voltage=16.0)
    bridge = Px4Bridge(dataclasses.replace(config, thrust_map=reference), new)
    tell(bridge, "/fmu/out/vehicle_status_v4", px4_status(new, 14), T0)
    battery = new("px4_msgs/msg/BatteryStatus")
    battery.voltage_v = 15.0
    tell(bridge, "/fmu/out/battery_status_v1", battery, T0)
    rates = bridge.receive_command(command(T0), now_ns=T0)[1].message
    assert 0.3 < -rates.thrust_body[2] < 0.4
