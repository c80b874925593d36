# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of MAVLink messages, and the messages that the bridge sends to PX4 and ArduPilot."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import AXES, FRD, HOVER, SECOND, T0, command
from fixtures.mavlink import (
    ARDUPILOT,
    CRITICAL,
    GUIDED,
    LOITER,
    OFFBOARD,
    ON_GROUND,
    POSITION,
    PX4,
    SETTINGS,
    Setpoint,
    Speaker,
    asked_for,
    asked_time,
    heartbeat_requests,
    heartbeat_types,
    requests,
    setpoints,
)
from fixtures.stack_messages import new_message
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.ros.bridges.mavlink import MavlinkBridge
from quad_mpc_ros.ros.bridges.mavlink.link import VehicleClock

MILLISECOND = 1_000_000
STEP = 20 * MILLISECOND
NED = {(0, 1, 0): (1, 0, 0), (1, 0, 0): (0, 1, 0), (0, 0, 1): (0, 0, -1)}  # ENU: NED
NED |= {tuple(-a for a in enu): tuple(-a for a in ned) for enu, ned in NED.items()}


def made(**parameters: Any) -> MavlinkBridge:
    return MavlinkBridge(MavlinkBridge.Config.build(parameters), new_message)


def odometry_from(
    data: bytes, bridge: MavlinkBridge | None = None, now_ns: int = T0
) -> OdometrySample:
    """Return the one odometry that the bridge makes of messages of the autopilot."""
    bridge = bridge or made()
    bridge.exchange(data, now_ns=now_ns)
    ((odometry, _),) = bridge.take_odometries()
    return odometry


def engaged(speaker: Speaker, now_ns: int = T0, bridge: Any = None, **state: Any) -> MavlinkBridge:
    """Return a bridge that flies."""
    bridge = bridge or made()
    bridge.exchange(speaker.state_messages(now_ns, **state), now_ns=now_ns)
    bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns)
    answer = bridge.engage(True, now_ns=now_ns)
    assert answer.accepted, answer.text
    return bridge


def sent(bridge: MavlinkBridge, now_ns: int, throttle: float = HOVER, w: Any = (0, 0, 0)) -> bytes:
    """Return what goes out for a command."""
    outgoing = bridge.receive_command(command(now_ns, throttle, w), now_ns=now_ns)
    assert all(isinstance(each, bytes) for each in outgoing)
    return b"".join(each for each in outgoing if isinstance(each, bytes))


def setpoint(bridge: MavlinkBridge, now_ns: int = T0, **given: Any) -> Setpoint:
    (found,) = setpoints(sent(bridge, now_ns, **given))
    return found


# Frames.


@pytest.mark.parametrize("axis", AXES)
def test_converts_odometry_axis_by_axis(axis: tuple[float, float, float]) -> None:
    ned, frd = NED[axis], FRD[axis]
    x, y, z = ned
    rates = dict(zip(("rollspeed", "pitchspeed", "yawspeed"), frd, strict=True))
    velocity = dict(zip(("vx", "vy", "vz"), frd, strict=True))
    speaker = Speaker()
    head = speaker.heartbeat(autopilot=PX4)
    seen = odometry_from(head + speaker.odometry(T0, x=x, y=y, z=z, **velocity, **rates))
    assert_allclose(seen.p_WB, axis)
    assert_allclose(seen.v_WB_B, axis)
    assert_allclose(seen.w_WB_B, axis)

    velocity = dict(zip(("vx", "vy", "vz"), ned, strict=True))
    seen = odometry_from(head + speaker.odometry(T0, child_frame_id=1, **velocity))
    R_WB = so3.rotation_from_quaternion_xyzw(seen.q_WB_xyzw)
    assert_allclose(R_WB @ seen.v_WB_B, axis, atol=1e-7)


def test_attitude_is_predicted_to_the_stamp_of_the_position() -> None:
    speaker, bridge = Speaker(), made()
    before = T0 - 10 * MILLISECOND
    data = speaker.heartbeat() + speaker.attitude(before, w=(0.0, 0.0, 2.0))
    seen = odometry_from(data + speaker.position(T0), bridge)
    # Turning to the right from north: 0.02 rad towards the east.
    R_WB = so3.rotation_from_quaternion_xyzw(seen.q_WB_xyzw)
    assert_allclose(R_WB[:, 0], (math.sin(0.02), math.cos(0.02), 0.0), atol=1e-6)
    bridge.exchange(speaker.position(T0 + 60 * MILLISECOND), now_ns=T0 + 60 * MILLISECOND)
    assert bridge.take_odometries() == []  # too far apart


@pytest.mark.parametrize("axis", AXES)
def test_converts_setpoints_axis_by_axis(axis: tuple[float, float, float]) -> None:
    for autopilot, mode in ((ARDUPILOT, GUIDED), (PX4, OFFBOARD)):
        bridge = engaged(Speaker(), autopilot=autopilot, mode=mode)
        found = setpoint(bridge, throttle=0.4, w=1.5 * np.array(axis))
        assert_allclose(found.rates, 1.5 * np.array(FRD[axis]))
        assert (found.type_mask, found.target) == (0x80, (1, 1))


def test_unknown_frames_and_no_attitude_are_refused() -> None:
    speaker, bridge = Speaker(), made()
    bridge.exchange(speaker.heartbeat(autopilot=PX4), now_ns=T0)
    for changes in (
        {"frame_id": 3},
        {"child_frame_id": 20},
        {"q": [0.0] * 4},
        {"x": math.nan},
        {"rollspeed": math.inf},
    ):
        bridge.exchange(speaker.odometry(T0, **changes), now_ns=T0)
    assert bridge.take_odometries() == [] and bridge.refused == 5
    bridge = made()
    bridge.exchange(speaker.heartbeat() + speaker.attitude(T0, w=(math.nan, 0, 0)), now_ns=T0)
    bridge.exchange(speaker.position(T0), now_ns=T0)
    assert bridge.take_odometries() == [] and bridge.refused == 1


def test_publishes_a_reset_that_px4_announces() -> None:
    speaker, bridge = Speaker(), made()
    bridge.exchange(speaker.heartbeat(autopilot=PX4) + speaker.odometry(T0), now_ns=T0)
    now_ns = T0 + STEP
    bridge.exchange(speaker.odometry(now_ns, x=3.0, reset_counter=1), now_ns=now_ns)
    (_, before), (_, reset) = bridge.take_odometries()
    assert before is None and reset is not None
    assert_allclose(reset.step_W, (0.0, 3.0, 0.0), atol=1e-6)


# Thrust.


def level_of(thrust: float, *, up: float, boost: bool, expo: float) -> float:
    """Return the motors' level that ArduPilot makes of a thrust: AC_AttitudeControl_Multi.cpp and
    AP_Motors_Thrust_Linearization.cpp."""
    if boost:
        thrust *= min(max(10.0 * up, 0.0), 1.0) / min(max(up, 0.1), 1.0)
    ratio = thrust
    if expo:
        ratio = (expo - 1.0 + math.sqrt((1.0 - expo) ** 2 + 4.0 * expo * thrust)) / (2.0 * expo)
    return 0.15 + (0.95 - 0.15) * ratio


@given(
    st.floats(0.16, 0.94),
    st.floats(-1.2, 1.2),
    st.booleans(),
    st.sampled_from((-0.3, 0.0, 0.4, 0.65, 1.0)),
)
@settings(deadline=None, max_examples=60)
def test_compensates_ardupilots_throttle_scaling(
    level: float, tilt: float, boost: bool, expo: float
) -> None:
    speaker = Speaker()
    known = {"ATC_ANGLE_BOOST": float(boost), "MOT_THST_EXPO": expo}
    bridge = engaged(speaker, settings=known)
    now_ns = T0 + STEP
    q_wxyz = math.cos(tilt / 2.0), math.sin(tilt / 2.0), 0.0, 0.0
    bridge.exchange(speaker.attitude(now_ns, q_wxyz) + speaker.position(now_ns), now_ns=now_ns)
    thrust = setpoint(bridge, now_ns, throttle=level).thrust
    made_of_it = level_of(thrust, up=math.cos(tilt), boost=boost, expo=expo)
    assert made_of_it == pytest.approx(level, abs=1e-5)


def test_compensates_the_boost_at_the_predicted_tilt() -> None:
    """Turning at 2 rad/s, 20 ms after the attitude: 30 ms until it acts."""
    speaker, known = Speaker(), {"ATC_ANGLE_BOOST": 1.0, "MOT_THST_EXPO": 0.0}
    bridge = engaged(speaker, settings=known)
    q_wxyz = math.cos(0.25), math.sin(0.25), 0.0, 0.0
    data = speaker.attitude(T0 + STEP, q_wxyz, w=(2.0, 0.0, 0.0)) + speaker.position(T0 + STEP)
    bridge.exchange(data, now_ns=T0 + STEP)
    thrust = setpoint(bridge, T0 + 2 * STEP, throttle=0.55).thrust
    assert thrust == pytest.approx(0.5 * math.cos(0.5 + 2.0 * 0.03), abs=1e-5)


def test_requests_heartbeat_intervals_and_parameters_at_connection() -> None:
    speaker, bridge = Speaker(system=7), made(state_rate=50.0)
    quiet = bridge.exchange(b"", now_ns=T0)
    assert requests(quiet) == [] and asked_for(quiet) == []
    asked = bridge.exchange(speaker.heartbeat(), now_ns=T0 + STEP)
    assert set(asked_for(asked)) == set(SETTINGS)
    intervals = {each.parameters[0]: each.parameters[1] for each in requests(asked)}
    assert intervals[31.0] == intervals[32.0] == 20_000.0  # us
    assert {1.0, 245.0, 436.0} < set(intervals) and not {0.0, 331.0} & set(intervals)
    assert {each.target for each in requests(asked)} == {(7, 1)}
    assert {each.command for each in requests(asked)} == {511}
    # The same again while nothing comes, not more often than once a second.
    again = [
        len(requests(bridge.exchange(speaker.heartbeat(), now_ns=T0 + k * STEP)))
        for k in range(2, 152)
    ]
    assert sum(count > 0 for count in again) == 3


@pytest.mark.parametrize(("autopilot", "state"), [(ARDUPILOT, 32.0), (PX4, 331.0)])
def test_requests_the_rate_of_periodic_messages_once(autopilot: int, state: float) -> None:
    speaker, bridge = Speaker(), made()
    for k in range(200):
        now_ns = T0 + k * STEP
        asked = bridge.exchange(speaker.state_messages(now_ns, autopilot=autopilot), now_ns=now_ns)
        if k == 0:
            assert (state, 10_000.0) in [each.parameters[:2] for each in requests(asked)]
        else:
            assert requests(asked) == asked_for(asked) == []


def test_refuses_to_engage_before_the_parameters_are_received() -> None:
    speaker, bridge = Speaker(), made()
    data = speaker.heartbeat() + speaker.land() + speaker.attitude(T0) + speaker.position(T0)
    bridge.exchange(data, now_ns=T0)
    bridge.receive_command(command(T0, HOVER), now_ns=T0)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and "has not sent its parameters yet" in refused.text
    for k in range(200):  # it never does
        bridge.exchange(speaker.heartbeat(), now_ns=T0 + k * STEP)
    assert "does not report its parameter" in bridge.engage(True, now_ns=T0 + 199 * STEP).text


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (
            {"GUID_OPTIONS": 0.0},
            "GUID_OPTIONS is 0, which makes thrust a climb rate: set it to 8",
        ),
        ({"GUID_OPTIONS": 64.0}, "set it to 72 (bit 3)"),
    ],
)
def test_refuses_to_engage_with_unsafe_settings(known: dict[str, float], said: str) -> None:
    bridge = made()
    bridge.exchange(Speaker().state_messages(T0, settings=known), now_ns=T0)
    bridge.receive_command(command(T0, HOVER), now_ns=T0)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and said in refused.text


@pytest.mark.parametrize(
    ("autopilot", "known", "said"),
    [
        (ARDUPILOT, {"GUID_TIMEOUT": 3.0}, "GUID_TIMEOUT is 3 s"),
        (PX4, {"COM_OF_LOSS_T": 2.0}, "COM_OF_LOSS_T is 2 s"),
    ],
)
def test_warns_once_of_setpoints_that_are_held_too_long(
    autopilot: int, known: dict[str, float], said: str
) -> None:
    bridge = made()
    data = Speaker().state_messages(T0, autopilot=autopilot, settings=known)
    bridge.exchange(data, now_ns=T0)
    (warning,) = bridge.take_warnings()
    assert said in warning
    bridge.exchange(data, now_ns=T0 + STEP)
    assert bridge.take_warnings() == []


def test_applies_a_setting_changed_in_flight() -> None:
    speaker = Speaker()
    bridge = engaged(speaker)
    bridge.exchange(speaker.parameter("GUID_OPTIONS", 0.0), now_ns=T0 + STEP)
    assert sent(bridge, T0 + STEP) == b"" and "climb rate" in bridge.handover[1]


def test_px4_integers_are_encoded_in_the_bytes_of_a_float() -> None:
    speaker, bridge = Speaker(), made()
    data = speaker.heartbeat(autopilot=PX4) + speaker.parameter("COM_OF_LOSS_T", 5, integer=True)
    bridge.exchange(data, now_ns=T0)
    assert any("COM_OF_LOSS_T is 5 s" in each for each in bridge.take_warnings())


# Time.


@pytest.mark.parametrize(("there", "back"), [(0, 0), (4, 4), (8, 2), (1, 9)])
def test_stamps_are_accurate_to_half_the_round_trip(there: int, back: int) -> None:
    """The vehicle's clock began 3,000 s later; its state is as late as its answers are."""
    speaker, bridge = Speaker(), made()
    behind = 3_000 * SECOND
    asked: list[int] = []
    worst = 0.0
    on_the_way: list[tuple[int, bytes]] = []
    for k in range(400):
        now_ns = 4_000 * SECOND + k * 5 * MILLISECOND
        if k % 4 == 0:
            state = speaker.attitude(now_ns - behind) + speaker.position(now_ns - behind)
            on_the_way.append((now_ns + back * MILLISECOND, state + speaker.heartbeat()))
        for sent_ns in asked:
            data = speaker.say("timesync", sent_ns + there * MILLISECOND - behind, sent_ns)
            on_the_way.append((sent_ns + (there + back) * MILLISECOND, data))
        arrived = b"".join(data for at_ns, data in on_the_way if at_ns <= now_ns)
        on_the_way = [each for each in on_the_way if each[0] > now_ns]
        asked = asked_time(bridge.exchange(arrived, now_ns=now_ns))
        for odometry, _ in bridge.take_odometries():
            age_ms = (now_ns - odometry.stamp_ns) / MILLISECOND
            late_ms = (now_ns - 4_000 * SECOND) % (20 * MILLISECOND) / MILLISECOND
            if k > 100:
                worst = max(worst, abs(age_ms - late_ms))
    assert worst <= 0.5 * (there + back) + 5.1  # ours is looked at every 5 ms


@pytest.mark.parametrize("drift", [-0.04, 0.0, 0.015, 0.04])
def test_stamps_follow_a_drifting_clock_with_slow_responses(drift: float) -> None:
    """A simulation beside other work: its clock is slow, and one answer in twenty comes soon."""
    dice, time = random.Random(5), VehicleClock()
    for k in range(600):  # a minute
        sent_ns = T0 + k * SECOND // 10
        time.note_request(now_ns=sent_ns)
        trip = 3 * MILLISECOND if k % 20 == 0 else dice.randrange(10, 60) * MILLISECOND
        read_ns = sent_ns + dice.randrange(trip)
        vehicle_ns = round((read_ns - T0) * (1.0 - drift))
        time.receive(sent_ns=sent_ns, vehicle_ns=vehicle_ns, now_ns=sent_ns + trip)
        assert abs(vehicle_ns + time.offset_ns - read_ns) <= trip
        if k > 20:
            assert abs(vehicle_ns + time.offset_ns - read_ns) < 70 * MILLISECOND


# Who flies.


def test_requests_guided_mode_and_sends_setpoints_only_in_it() -> None:
    speaker, bridge = Speaker(), made()
    bridge.exchange(speaker.state_messages(T0, mode=LOITER), now_ns=T0)
    assert sent(bridge, T0) == b""
    assert bridge.engage(True, now_ns=T0).accepted
    (asked,) = requests(sent(bridge, T0))
    assert (asked.command, asked.parameters[:2]) == (176, (1.0, 4.0))
    bridge.exchange(speaker.state_messages(T0 + STEP), now_ns=T0 + STEP)
    assert len(setpoints(sent(bridge, T0 + STEP))) == 1
    bridge.exchange(speaker.state_messages(T0 + 2 * STEP, mode=LOITER), now_ns=T0 + 2 * STEP)
    assert sent(bridge, T0 + 2 * STEP) == b""
    assert "ArduPilot switched to LOITER for a pilot" in bridge.handover[1]
    bridge.exchange(speaker.state_messages(T0 + 3 * STEP), now_ns=T0 + 3 * STEP)  # and back
    assert sent(bridge, T0 + 3 * STEP) == b""


def test_px4_receives_setpoints_before_the_offboard_request() -> None:
    speaker, bridge = Speaker(), made()
    bridge.exchange(speaker.state_messages(T0, autopilot=PX4, mode=POSITION), now_ns=T0)
    sent(bridge, T0)
    assert bridge.engage(True, now_ns=T0).accepted
    asked_ns = None
    for k in range(1, 80):
        now_ns = T0 + k * STEP
        bridge.exchange(
            speaker.state_messages(now_ns, autopilot=PX4, mode=POSITION), now_ns=now_ns
        )
        data = sent(bridge, now_ns)
        assert len(setpoints(data)) == 1
        if asked_ns is None and requests(data):
            (asked,) = requests(data)
            assert (asked.command, asked.parameters[:3]) == (176, (1.0, 6.0, 0.0))
            asked_ns = now_ns
    assert asked_ns is not None and 1.0 < 1e-9 * (asked_ns - T0) < 1.2


@pytest.mark.parametrize(
    ("autopilot", "mode", "asked"),
    [(ARDUPILOT, GUIDED, (1.0, 5.0, 0.0)), (PX4, OFFBOARD, (1.0, 4.0, 3.0))],
)
def test_requests_release_and_arming(autopilot: int, mode: int, asked: tuple[float, ...]) -> None:
    bridge = engaged(Speaker(), autopilot=autopilot, mode=mode)
    for response, command_number, parameters in (
        (bridge.arm(True, now_ns=T0), 400, (1.0,)),
        (bridge.arm(False, now_ns=T0), 400, (0.0,)),
        (bridge.engage(False, now_ns=T0), 176, asked),
    ):
        (message,) = response.messages
        assert isinstance(message, bytes)
        (request,) = requests(message)
        assert response.accepted and request.command == command_number
        assert request.parameters[: len(parameters)] == parameters
    assert sent(bridge, T0) == b""


def test_engaging_is_refused_in_a_failsafe_and_without_a_heartbeat() -> None:
    bridge = made()
    answer = bridge.arm(True, now_ns=T0)
    assert not answer.accepted and "no heartbeat" in answer.text
    bridge.exchange(Speaker().state_messages(T0, status=CRITICAL), now_ns=T0)
    bridge.receive_command(command(T0, HOVER), now_ns=T0)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and "failsafe" in refused.text
    assert any("reports a failsafe" in each for each in bridge.take_warnings())


def test_ignores_vehicles_other_than_the_configured_one() -> None:
    bridge = made(target_system=2)
    bridge.exchange(Speaker(system=1).state_messages(T0), now_ns=T0)
    assert bridge.take_odometries() == []
    ground_station = Speaker(system=2, component=190).say("heartbeat", 6, 8, 0, 0, 4, 3)
    bridge.exchange(ground_station + Speaker(system=2).state_messages(T0), now_ns=T0)
    assert len(bridge.take_odometries()) == 1


def test_a_setpoint_of_another_sender_ends_the_engagement() -> None:
    speaker, other = Speaker(), Speaker(system=255, component=190)
    bridge = engaged(speaker)
    assert len(setpoints(sent(bridge, T0))) == 1
    strange = other.say("set_attitude_target", 0, 1, 1, 0x80, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.3)
    bridge.exchange(strange, now_ns=T0 + STEP)
    assert sent(bridge, T0 + STEP) == b""
    assert "SET_ATTITUDE_TARGET of system 255, component 190" in bridge.handover[1]
    assert "another sender" in bridge.engage(True, now_ns=T0 + STEP).text


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
@pytest.mark.parametrize(("strange", "ends"), [(0, False), (2, False), (3, True), (60, True)])
def test_unknown_targets_end_the_engagement(autopilot: int, strange: int, ends: bool) -> None:
    """A target comes late, and among those of the others are ours."""
    speaker, dice = Speaker(), random.Random(3)
    mode = GUIDED if autopilot == ARDUPILOT else OFFBOARD
    bridge = engaged(speaker, autopilot=autopilot, mode=mode)
    late: list[Setpoint] = []
    for k in range(150):
        now_ns = T0 + k * STEP
        bridge.exchange(
            speaker.state_messages(now_ns, autopilot=autopilot, mode=mode), now_ns=now_ns
        )
        w = np.array([dice.uniform(-1, 1) for _ in range(3)])
        late += setpoints(sent(bridge, now_ns, throttle=dice.uniform(0.25, 0.35), w=w))
        if k > 5:
            target = late[-5]
            off = 0.11 if k % 4 == 0 and 80 <= k < 80 + 4 * strange else 0.0
            rates = [rate + off for rate in target.rates]
            data = speaker.say(
                "attitude_target", 0, 0, [1.0, 0.0, 0.0, 0.0], *rates, target.thrust + off
            )
            bridge.exchange(data, now_ns=now_ns)
    assert bridge.handover[0] == ("released" if ends else "engaged")
    assert ("the vehicle follows setpoints of another sender" in bridge.handover[1]) is ends


@pytest.mark.parametrize(("autopilot", "wait"), [(ARDUPILOT, 1.0), (ARDUPILOT, 0.0), (PX4, 1.0)])
def test_requests_land_mode_once_after_landing(autopilot: int, wait: float) -> None:
    speaker, mode = Speaker(), GUIDED if autopilot == ARDUPILOT else OFFBOARD
    reported = {"autopilot": autopilot, "mode": mode}
    bridge = engaged(speaker, bridge=made(land_mode_after=wait), **reported)
    asked_ns = None
    states = 20 * ["on_ground"] + 50 * ["flying"] + 20 * ["touching_down"] + 100 * ["on_ground"]
    for k, state in enumerate(states):
        now_ns = T0 + k * STEP
        bridge.receive_ground(GroundState(state))
        found = requests(
            bridge.exchange(speaker.state_messages(now_ns, **reported), now_ns=now_ns)
        )
        sent(bridge, now_ns)
        modes = [each.parameters[:2] for each in found if each.command == 176]
        if modes:
            assert modes == [(1.0, 9.0)] and asked_ns is None
            asked_ns = now_ns
    if autopilot == PX4 or wait == 0.0:
        assert asked_ns is None and bridge.handover[0] == "engaged"
    else:
        assert asked_ns == T0 + 90 * STEP + round(wait * SECOND)
        assert "after landing" in bridge.handover[1]


# Mode changes.


def tick(bridge: MavlinkBridge, data: bytes, now_ns: int) -> bytes:
    """Deliver bytes and a command to a bridge, and return the bytes that it sends."""
    out = bridge.exchange(data, now_ns=now_ns)
    return out + sent(bridge, now_ns)


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_requests_ten_heartbeats_a_second(autopilot: int) -> None:
    speaker, bridge = Speaker(), made()
    count = 0
    for k in range(100):
        now_ns = T0 + k * STEP
        asked = bridge.exchange(speaker.state_messages(now_ns, autopilot=autopilot), now_ns=now_ns)
        count += heartbeat_requests(asked)
    assert count == 20  # in 2 s


HOLD = 4 << 16 | 3 << 24


@pytest.mark.parametrize(
    ("intended", "reason"),
    [
        (OFFBOARD, "PX4 switched to AUTO.LOITER in a failsafe"),
        (HOLD, "PX4 switched to AUTO.LOITER for a pilot or a ground station"),
    ],
)
def test_px4_leaving_offboard_for_one_tenth_of_a_second_ends_the_engagement(
    intended: int, reason: str
) -> None:
    speaker = Speaker()
    bridge = engaged(speaker, autopilot=PX4, mode=OFFBOARD)
    bridge.exchange(speaker.current_mode(HOLD, intended=intended), now_ns=T0 + STEP)
    assert sent(bridge, T0 + STEP) == b"" and reason in bridge.handover[1]
    back = speaker.current_mode(OFFBOARD, intended=OFFBOARD)
    assert setpoints(tick(bridge, back, T0 + 6 * STEP)) == []


def test_requests_a_heartbeat_at_once_after_a_change_of_px4s_state() -> None:
    """CURRENT_MODE comes with arming and disarming as well, but only the heartbeat has them."""
    speaker = Speaker()
    bridge = engaged(speaker, autopilot=PX4, mode=OFFBOARD)
    change = speaker.current_mode(OFFBOARD, intended=OFFBOARD)
    assert heartbeat_requests(bridge.exchange(change, now_ns=T0 + MILLISECOND)) == 1
    disarmed = speaker.heartbeat(autopilot=PX4, mode=OFFBOARD, armed=False)
    assert setpoints(tick(bridge, disarmed, T0 + 3 * MILLISECOND)) == []
    assert "released by disarming" in bridge.handover[1]


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
@pytest.mark.parametrize("leaves", [True, False])
def test_foreign_targets_are_decided_by_the_next_reported_mode(
    autopilot: int, leaves: bool
) -> None:
    """An autopilot in another mode follows its own setpoints, and reports them at 20 Hz."""
    speaker = Speaker()
    mode = GUIDED if autopilot == ARDUPILOT else OFFBOARD
    other = LOITER if autopilot == ARDUPILOT else POSITION
    bridge = engaged(speaker, autopilot=autopilot, mode=mode)
    now_ns = T0
    for k in range(1, 40):
        now_ns = T0 + k * STEP
        tick(bridge, speaker.state_messages(now_ns, autopilot=autopilot, mode=mode), now_ns)
    target = speaker.say("attitude_target", 0, 0, [1.0, 0.0, 0.0, 0.0], 2.0, 2.0, 2.0, 0.9)
    for _ in range(5):
        now_ns += STEP
        out = tick(bridge, speaker.odometry(now_ns) + target, now_ns)
    assert bridge.handover[0] == "engaged"
    assert heartbeat_requests(out) == 1  # asked for at once, at every further target
    heartbeat = speaker.heartbeat(autopilot=autopilot, mode=other if leaves else mode)
    tick(bridge, heartbeat, now_ns + STEP)
    assert bridge.handover[0] == "released"
    assert ("for a pilot or a ground station" in bridge.handover[1]) is leaves
    assert ("the vehicle follows setpoints of another sender" in bridge.handover[1]) is not leaves


def test_stale_heartbeats_end_the_engagement() -> None:
    speaker = Speaker()
    bridge = engaged(speaker, autopilot=PX4, mode=OFFBOARD)
    for k in range(1, 100):
        now_ns = T0 + k * STEP
        tick(bridge, speaker.odometry(now_ns), now_ns)
    assert "no heartbeat of PX4 or ArduPilot within 1.5 s" in bridge.handover[1]


# Arming.


@pytest.mark.parametrize("text_first", [True, False])
def test_a_refusal_to_arm_is_answered_with_the_reason_of_the_autopilot(text_first: bool) -> None:
    speaker, bridge = Speaker(), made()
    reported = {"autopilot": PX4, "mode": POSITION, "armed": False, "land": ON_GROUND}
    bridge.exchange(speaker.state_messages(T0, **reported), now_ns=T0)
    assert bridge.arm(True, now_ns=T0).accepted
    text = speaker.say("statustext", 2, b"Arming denied: no valid position\t")
    refusal = speaker.say("command_ack", 400, 1)
    pieces = [text, refusal] if text_first else [refusal, text]
    for k, piece in enumerate(pieces, 1):
        bridge.exchange(piece, now_ns=T0 + k * STEP)
        assert bridge.arming_outcome(now_ns=T0 + k * STEP) is None
    outcome = bridge.arming_outcome(now_ns=T0 + SECOND // 2)
    assert outcome is not None and not outcome.accepted
    assert outcome.text == (
        "the autopilot refuses arming: temporarily rejected: Arming denied: no valid position"
    )


@pytest.mark.parametrize(
    ("autopilot", "on_loss", "announces"),
    [(PX4, 0, True), (PX4, 2, False), (ARDUPILOT, None, False)],
)
def test_acts_as_ground_station_only_if_px4_ignores_its_loss(
    autopilot: int, on_loss: int | None, announces: bool
) -> None:
    """PX4 sends its texts only to ground stations, and may fly home when the last one is lost."""
    speaker, bridge = Speaker(), made()
    known = {} if on_loss is None else {"NAV_DLL_ACT": float(on_loss)}
    types: list[tuple[int, int]] = []
    for k in range(100):
        now_ns = T0 + k * STEP
        data = speaker.state_messages(now_ns, autopilot=autopilot, settings=known)
        types += heartbeat_types(bridge.exchange(data, now_ns=now_ns))
    onboard, station = (191, 18), (190, 6)
    assert types.count(onboard) == 2 and types.count(station) == 2 * announces


# Landed state, battery and texts.


def test_joins_the_parts_of_a_long_text() -> None:
    speaker, bridge = Speaker(), made()
    bridge.exchange(speaker.heartbeat(), now_ns=T0)
    pieces = (b"Arm: AHRS: EKF3 Yaw inconsistent 77 deg. Wait or r", b"eboot")
    for number, piece in enumerate(pieces):
        bridge.exchange(speaker.say("statustext", 2, piece, 5, number), now_ns=T0)
    (warning,) = bridge.take_warnings()
    assert warning.endswith("Wait or reboot")


def test_landed_battery_refusals_and_texts() -> None:
    speaker = Speaker()
    bridge = made(**{"thrust_map.battery_voltage": 16.0})
    bridge.exchange(speaker.state_messages(T0), now_ns=T0)
    assert bridge.landed(now_ns=T0) is False
    bridge.exchange(speaker.land(ON_GROUND), now_ns=T0)
    assert bridge.landed(now_ns=T0) is True
    bridge.take_warnings()
    status = speaker.say("sys_status", 0, 0, 0, 0, 14_400, -1, -1, 0, 0, 0, 0, 0, 0)
    bridge.exchange(status, now_ns=T0)
    assert bridge.thrust.battery_scale == pytest.approx(0.81)
    refused = speaker.say("command_ack", 400, 4) + speaker.say("command_ack", 400, 0)
    text = speaker.say("statustext", 2, b"Arm: Throttle too high")
    text += speaker.say("statustext", 6, b"EKF3 IMU0 is using GPS")
    bridge.exchange(refused + text, now_ns=T0)
    assert bridge.take_warnings() == [
        "the autopilot refuses arming: failed",
        "the autopilot reports: Arm: Throttle too high",
    ]


@pytest.mark.parametrize("device", ["udpin:14550", "tcp:host:port", "udpout::99999", "tcp:a:0"])
def test_refuses_an_invalid_address(device: str) -> None:
    with pytest.raises(ConfigurationError, match=r"mavlink_bridge\.device"):
        MavlinkBridge.Config(device=device)


# Whatever comes over the line.


def test_2000_fuzzed_frames_are_dropped_or_correct() -> None:
    """Bits turned, pieces lost, frames run together: what gets through is what was said."""
    dice, speaker = random.Random(7), Speaker()
    bridge = engaged(speaker)
    bridge.take_odometries()
    places = {}
    passed = 0
    for k in range(2000):
        now_ns = T0 + (k + 1) * MILLISECOND
        place = tuple(float(np.float32(dice.uniform(-90, 90))) for _ in range(3))
        places[now_ns // MILLISECOND] = place
        frame = bytearray(speaker.attitude(now_ns) + speaker.position(now_ns, p=place))
        match dice.randrange(5):
            case 0:
                for _ in range(dice.randrange(1, 5)):
                    frame[dice.randrange(len(frame))] ^= 1 << dice.randrange(8)
            case 1:
                begin = dice.randrange(len(frame))
                del frame[begin : begin + dice.randrange(1, 40)]
            case 2:
                frame = bytearray(dice.randbytes(dice.randrange(300))) + frame
            case 3:
                frame += frame[: dice.randrange(len(frame))]
        bridge.exchange(bytes(frame), now_ns=now_ns)
        for odometry, _ in bridge.take_odometries():
            said = places[round((odometry.stamp_ns) / MILLISECOND)]
            assert_allclose(odometry.p_WB, (said[1], said[0], -said[2]))
            passed += 1
        bridge.take_warnings()
    assert passed > 800


ABSURD = [0.0, -0.0, 1.0, -7.0, 1e8, 3.4e38, -3.4e38, 1e-40, math.nan, math.inf, -math.inf]


def test_2000_implausible_valid_frames_cause_no_error() -> None:
    dice, speaker = random.Random(11), Speaker()
    kinds = ["odometry", "attitude_quaternion", "local_position_ned", "attitude_target"]
    kinds += ["heartbeat", "sys_status", "extended_sys_state", "timesync", "param_value"]
    kinds += ["command_ack", "statustext", "set_attitude_target", "radio_status", "current_mode"]
    bridge = made(**{"thrust_map.battery_voltage": 16.0})
    for k in range(2000):
        now_ns = T0 + k * STEP
        if k % 50 == 0:
            bridge.exchange(speaker.state_messages(now_ns), now_ns=now_ns)
            bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns)
            bridge.engage(True, now_ns=now_ns)
        with np.errstate(all="ignore"):
            bridge.exchange(absurd(speaker, dice.choice(kinds), dice), now_ns=now_ns)
            for odometry, _ in bridge.take_odometries():
                assert np.all(np.isfinite([*odometry.p_WB, *odometry.v_WB_B, *odometry.w_WB_B]))
            for found in setpoints(sent(bridge, now_ns)):
                assert 0.0 <= found.thrust <= 1.0 and np.all(np.isfinite(found.rates))


def absurd(speaker: Speaker, kind: str, dice: random.Random) -> bytes:
    """Return a message of a kind with invalid numbers."""
    from pymavlink.dialects.v20 import development

    message = getattr(development, f"MAVLink_{kind}_message")
    values: list[Any] = []
    for kind_of, length in zip(message.fieldtypes, ordered(message), strict=True):
        if kind_of == "char":
            values.append(dice.choice((b"GUID_OPTIONS", b"\xff\xfe", b"", b"MOT_THST_EXPO")))
        elif kind_of in ("float", "double"):
            numbers = [dice.choice(ABSURD) for _ in range(max(length, 1))]
            values.append(numbers if length > 1 else numbers[0])
        else:
            # A kind may go on after its type: "uint8_t_mavlink_version".
            limits = np.iinfo(kind_of.split("_")[0])
            numbers = (0, 1, 2, 12, int(limits.max), int(limits.min), int(limits.max) // 2)
            values.append(dice.choice(numbers))
    return speaker.say(kind, *values)


def ordered(message: Any) -> list[int]:
    """Return the lengths of arrays by the fields' names."""
    lengths = dict(zip(message.ordered_fieldnames, message.array_lengths, strict=True))
    return [lengths[name] for name in message.fieldnames]
