# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to the Crazyflie, compared with the firmware's documentation and recorded packets."""

from __future__ import annotations

import dataclasses
import math
import random
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fixtures import crazyflie
from fixtures.bridges import AXES, HOVER, SECOND, T0, command, deliver, deliver_all, engage
from fixtures.stack_messages import sound_message

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.extras.bridges.crazyflie import CrazyflieBridge
from quad_mpc_ros.extras.bridges.crazyflie.line import CrazyflieLine
from quad_mpc_ros.extras.bridges.crazyflie.session import Session
from quad_mpc_ros.ros.bridges.bridge import Outgoing

New = Callable[[str], Any]

SEED, FRAMES = 7, 2000
SAID = Path(__file__).parents[2] / "fixtures" / "recorded" / "crazyflie_session.crtp"
"""All that a firmware for simulation (branch sitl-release, 6a4d2d0) said: from its start to half a
second of flight, turning left side up by 0.5 rad/s at the end."""


def bytes_of(outgoing: list[Outgoing]) -> bytes:
    assert all(isinstance(each, bytes) for each in outgoing)
    return b"".join(each for each in outgoing if isinstance(each, bytes))


def ready(new: New, **parameters: Any) -> CrazyflieBridge:
    """Return an engaged bridge whose thrust is unlocked."""
    bridge = CrazyflieBridge(CrazyflieBridge.Config.build(parameters), new)
    assert engage(bridge, T0).accepted
    for _ in range(4):
        bridge.receive_command(command(T0, HOVER), now_ns=T0)
    assert bridge.engaged(now_ns=T0)
    return bridge


def setpoint(
    bridge: CrazyflieBridge, w: Any, *, throttle: float = HOVER, now_ns: int = T0
) -> tuple[float, ...]:
    sent = bridge.receive_command(command(now_ns, throttle, w), now_ns=now_ns)
    (found,) = crazyflie.setpoints(bytes_of(sent))
    return found


@pytest.mark.parametrize("axis", AXES)
def test_legacy_setpoint_has_nose_up_pitch_and_clockwise_yaw_in_degrees(
    new: New, axis: tuple[float, ...]
) -> None:
    p, q, r = axis
    roll, pitch, yaw, _ = setpoint(ready(new), np.radians(30.0) * np.array(axis))
    assert (roll, pitch, yaw) == pytest.approx((30.0 * p, -30.0 * q, -30.0 * r), abs=1e-5)


@pytest.mark.parametrize(("throttle", "pwm"), [(0.0, 0), (0.5, 32768), (1.0, 60000)])
def test_thrust_is_pwm_limited_to_60000(new: New, throttle: float, pwm: int) -> None:
    assert setpoint(ready(new), (0.0, 0.0, 0.0), throttle=throttle)[3] == pwm


def test_body_rates_of_a_tilted_vehicle_change_the_heading_rate(new: New) -> None:
    """The test compares the headings before and after a short turn."""
    bridge, random_state, now_ns = ready(new), np.random.default_rng(SEED), T0
    for _ in range(20):
        R_WB = so3.exp(random_state.uniform(-0.6, 0.6, 3))
        w = random_state.uniform(-1.0, 1.0, 3)
        now_ns += SECOND // 100
        message = sound_message("nav_msgs/msg/Odometry", now_ns)
        q = message.pose.pose.orientation
        q.x, q.y, q.z, q.w = map(float, so3.quaternion_xyzw_from_rotation(R_WB))
        deliver(bridge, "stack_odom", message, now_ns)
        turned = R_WB @ so3.exp(1e-6 * w)
        before, after = (math.atan2(R[1, 0], R[0, 0]) for R in (R_WB, turned))
        yaw = setpoint(bridge, w, now_ns=now_ns)[2]
        assert -math.radians(yaw) == pytest.approx((after - before) * 1e6, abs=1e-4)


def test_three_zero_setpoints_unlock_the_thrust(new: New) -> None:
    bridge = CrazyflieBridge(CrazyflieBridge.Config(), new)
    assert engage(bridge, T0).accepted
    thrusts = [setpoint(bridge, (0.0, 0.0, 0.0))[3] for _ in range(5)]
    assert thrusts[:3] == [0, 0, 0] and thrusts[4] > 0


def test_modes_are_set_until_they_are_confirmed_and_again_after_silence(new: New) -> None:
    bridge = CrazyflieBridge(CrazyflieBridge.Config(), new)

    def modes(now_ns: int) -> list[bytes]:
        asked = crazyflie.packets(bridge.exchange(b"", now_ns=now_ns))
        return [data for port, data in asked if port == 0x23]

    wanted = [b"\0" + name + b"\x08\0" for name in crazyflie.MODES]
    assert modes(T0) == wanted
    assert modes(T0 + SECOND // 4) == wanted
    deliver_all(bridge, T0 + SECOND // 2)
    assert modes(T0 + SECOND // 2 + SECOND // 4) == []
    assert modes(T0 + 2 * SECOND) == wanted


def test_a_refused_mode_is_reported_and_prevents_engaging(new: New) -> None:
    bridge = CrazyflieBridge(CrazyflieBridge.Config(), new)
    bridge.exchange(crazyflie.modes_set(error=2), now_ns=T0)
    assert "refuses to set flightmode.stabModeRoll: error 2" in bridge.take_warnings()[0]
    contents = crazyflie.contents((2, "supervisor.info"), (7, "pm.vbat"))
    bridge.exchange(contents, now_ns=T0)
    bridge.exchange(crazyflie.logged(), now_ns=T0)
    refused = bridge.engage(True, now_ns=T0)
    assert not refused.accepted and "rate modes" in refused.text


@pytest.mark.parametrize(
    ("info", "reason"),
    [(crazyflie.TUMBLED, "upside down"), (crazyflie.LOCKED, "locked: restart it")],
)
def test_reports_of_the_supervisor_end_the_flight(new: New, info: int, reason: str) -> None:
    bridge = ready(new)
    bridge.exchange(crazyflie.logged(info=crazyflie.ARMED | info), now_ns=T0)
    assert not bridge.engaged(now_ns=T0)
    assert reason in bridge.handover[1]


def test_voltage_reaches_the_thrust_map(new: New) -> None:
    bridge = ready(new, **{"thrust_map.battery_voltage": 4.0})
    assert bridge.thrust.battery_scale == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("external", "port", "size"), [("pose", 0x61, 29), ("position", 0x60, 12), ("none", 0, 0)]
)
def test_the_pose_goes_to_the_estimator_on_board(
    new: New, external: str, port: int, size: int
) -> None:
    bridge = CrazyflieBridge(CrazyflieBridge.Config(external=external), new)
    message = sound_message("nav_msgs/msg/Odometry", T0)
    p = message.pose.pose.position
    p.x, p.y, p.z = 1.0, 2.0, 3.0
    deliver(bridge, "stack_odom", message, T0)
    sent = [
        data
        for number, data in crazyflie.packets(bridge.exchange(b"", now_ns=T0))
        if number in (0x60, 0x61)
    ]
    assert [len(data) for data in sent] == ([size] if size else [])
    if external == "pose":
        assert struct.unpack("<B7f", sent[0]) == (8, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    if external == "position":
        assert struct.unpack("<3f", sent[0]) == (1.0, 2.0, 3.0)
    assert port in (0, 0x60, 0x61)


def test_lost_commands_in_flight_cause_one_land_request(new: New) -> None:
    bridge = ready(new)
    setpoint(bridge, (0.0, 0.0, 0.0))
    sent = b""
    for elapsed_ns in range(0, SECOND, SECOND // 100):
        now_ns = T0 + elapsed_ns
        deliver(bridge, "stack_odom", sound_message("nav_msgs/msg/Odometry", now_ns), now_ns)
        sent += bridge.exchange(crazyflie.logged(), now_ns=now_ns)
    landing = [(port, data) for port, data in crazyflie.packets(sent) if port in (0x71, 0x80)]
    assert [port for port, _ in landing] == [0x71, 0x80]
    assert landing[0][1] == struct.pack("<BI", 0, 100)
    assert landing[1][1][0] == 8
    assert not bridge.engaged(now_ns=T0 + SECOND)


def test_requests_no_landing_without_odometry(new: New) -> None:
    bridge = ready(new)
    setpoint(bridge, (0.0, 0.0, 0.0))
    sent = b"".join(
        bridge.exchange(crazyflie.logged(), now_ns=T0 + elapsed_ns)
        for elapsed_ns in range(SECOND // 4, SECOND, SECOND // 100)
    )
    assert not [port for port, _ in crazyflie.packets(sent) if port == 0x80]


def test_disarming_sends_a_zero_setpoint(new: New) -> None:
    bridge = ready(new)
    answer = bridge.arm(False, now_ns=T0)
    assert answer.accepted
    sent = bytes_of(list(answer.messages))
    assert next(crazyflie.packets(sent)) == (0xD0, b"\x01\x00")
    assert crazyflie.setpoints(sent) == [(0.0, 0.0, 0.0, 0)]
    assert not bridge.engaged(now_ns=T0)


def test_auto_arming_crazyflie_counts_as_disarmed_after_landing(new: New) -> None:
    bridge = ready(new)
    assert bridge.arm(False, now_ns=T0).accepted
    armed, arms_itself, flying = 2, 4, 16
    for info, outcome in ((armed | arms_itself | flying, None), (armed | arms_itself, True)):
        bridge.exchange(crazyflie.logged(info=info), now_ns=T0)
        found = bridge.arming_outcome(now_ns=T0)
        assert (None if found is None else found.accepted) is outcome


def test_recorded_firmware_packets_prepare_a_session_and_fly() -> None:
    session, reader = Session(), crtp.PacketReader()
    infos = []
    list(session.requests(now_ns=T0))
    for packet in reader.read(SAID.read_bytes()):
        session.receive(packet, now_ns=T0)
        if session._progress.is_searched and not session._progress.block:
            list(session.requests(now_ns=T0))
        infos.append(session.telemetry.info)
    assert session.telemetry.takes_rates and session.telemetry.faults == []
    assert [each.name for each in session._progress.block] == [
        "supervisor.info"
    ]  # no battery there
    assert infos[-1] == 2 + 4 + 8 + 16  # armed, by itself, can fly, flies
    assert not any(info & (crazyflie.TUMBLED | crazyflie.LOCKED) for info in infos)


def test_fuzzed_frames_have_no_side_effects(new: New) -> None:
    """Cut, changed and invented packets among sound ones: no error, and no false telemetry."""
    dice = random.Random(SEED)
    wrong = 0
    bridge = CrazyflieBridge(CrazyflieBridge.Config(), new)
    for number in range(FRAMES):
        if number % 50 == 0:
            bridge = CrazyflieBridge(CrazyflieBridge.Config(), new)
            bridge.exchange(crazyflie.prepared(), now_ns=T0)
            bridge.exchange(crazyflie.logged(), now_ns=T0)
        data = dice.randbytes(dice.randrange(31))
        header = dice.choice((0x52, 0x50, 0x51, 0x23, 0x20, dice.randrange(256)))
        if dice.random() < 0.3:
            frame = bytearray(crazyflie.logged(info=crazyflie.ARMED))
            frame[dice.randrange(1, len(frame))] ^= 1 << dice.randrange(8)
            data, header = bytes(frame[2:]), frame[1]
        is_block = header & 0xF3 == 0x52 and len(data) == 10 and data[0] == 1
        before = dataclasses.replace(bridge._session.telemetry)
        bridge.exchange(crazyflie.framed(header, data), now_ns=T0)
        after = bridge._session.telemetry
        expected = struct.unpack("<4xHf", data) if is_block else (before.info, before.voltage)
        found = (after.info, after.voltage)
        wrong += found != expected and not all(map(math.isnan, (found[1], expected[1])))
        wrong += after.takes_rates is not before.takes_rates
    assert wrong == 0


@pytest.mark.parametrize("cuts", [1, 2, 3, 7])
def test_parses_a_stream_in_any_fragments(cuts: int) -> None:
    stream = SAID.read_bytes()
    reader, whole = crtp.PacketReader(), list(crtp.PacketReader().read(stream))
    pieces = [stream[place : place + cuts] for place in range(0, len(stream), cuts)]
    assert [packet for piece in pieces for packet in reader.read(piece)] == whole


def test_the_link_sends_and_receives_by_cflib() -> None:
    pytest.importorskip("cflib")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        line = CrazyflieLine(f"udp://127.0.0.1:{peer.getsockname()[1]}")
        assert line.read() == b"" and line.fault == ""
        line.write(crtp.arm(True).framed() + crtp.log_reset().framed())
        first, sender = peer.recvfrom(64)
        assert (first[0] & 0xF3, first[1:]) == (0xD0, b"\x01\x01")
        assert peer.recv(64)[0] & 0xF3 == 0x51
        peer.sendto(b"\x5e\x01\x02", sender)
        until, found = time.monotonic() + 5.0, b""
        while not found and time.monotonic() < until:
            found = line.read()
        assert found == b"\x03\x5e\x01\x02"
        line.close()


def test_reports_an_address_of_another_kind() -> None:
    pytest.importorskip("cflib")
    line = CrazyflieLine("http://127.0.0.1")
    assert line.read() == b"" and "expected radio://" in line.fault


class _Cflib(ModuleType):
    """cflib's part that makes links; the first ``broken`` links fail while they are opened."""

    CLASSES = (object,)

    def __init__(self, broken: int) -> None:
        super().__init__("cflib.crtp")
        self.broken = broken
        self.errors: list[Callable[[str], object]] = []

    def get_link_driver(self, _uri: str, _quality: None, on_error: Callable[[str], object]) -> Any:
        self.errors.append(on_error)
        if len(self.errors) <= self.broken:
            on_error("too many packets lost\nretry")
        return SimpleNamespace(receive_packet=lambda _: None, close=lambda: None)


def test_reopens_a_link_lost_while_opening_and_ignores_late_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cflib, stack = _Cflib(broken=1), ModuleType("cflib.crtp.crtpstack")
    stack.CRTPPacket = object  # type: ignore[attr-defined]
    for name, module in (("cflib.crtp", cflib), ("cflib.crtp.crtpstack", stack)):
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr("quad_mpc_ros.ros.bridges.line.RECONNECT_PERIOD", 0.0)
    line = CrazyflieLine("radio://0")
    line.read()
    assert line.fault == "radio://0: too many packets lost"
    line.read()
    cflib.errors[0]("said late by the driver of the lost link")
    line.read()
    assert line.fault == "" and len(cflib.errors) == 2
    line.close()
