# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The MPC as a mode of PX4, against the rules of PX4's commander.

The stand-in for PX4 follows ModeManagement.cpp and externalChecks.cpp of PX4 1.16.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from fixtures.bridges import HOVER, SECOND, T0, command, deliver
from fixtures.stack_messages import DEFINITIONS, new_message

from quad_mpc_ros.ros.bridges.bridge import Outgoing, OutgoingMessage
from quad_mpc_ros.ros.bridges.px4 import ExternalModeBridge, Px4Bridge

HOLD, RETURN, MODE = 4, 5, 23
STEP = SECOND // 50
# Of messages whose definition is complete in stack_messages, from the build of PX4 1.16.
FORMATS = {
    "VehicleRatesSetpoint": 2040078695,
    "VehicleOdometry": 988836982,
    "ArmingCheckRequest": 2071694766,
    "ArmingCheckReply": 65702502,
}
# "Mode is unresponsive" and "Arm authorization denied" in the events of PX4 1.16.
UNRESPONSIVE, DENIED = 26592384, 22481569


def text_of(chars: Any) -> str:
    return bytes(chars).rstrip(b"\0").decode()


def fields_of(kind: str) -> str:
    """Return the fields of a message as PX4's generator writes them, without constants."""
    text = ""
    for line in DEFINITIONS[f"px4_msgs/msg/{kind}"].split("\n"):
        if not line.strip() or "=" in line:
            continue
        of_type, name = line.split()
        nested, _, _ = of_type.removeprefix("px4_msgs/").partition("[")
        text += f"{of_type.removeprefix('px4_msgs/')} {name}\n"
        if of_type.startswith("px4_msgs/"):
            text += fields_of(nested)
    return text


def format_of(topic: str) -> int:
    """Return PX4's number for the format of a topic."""
    kind = topic.rpartition("/")[2].title().replace("_", "")
    value = 0x811C9DC5
    for character in fields_of(kind):
        value = ((value ^ ord(character)) * 0x01000193) % 2**32
    assert value == FORMATS.get(kind, value)
    return value


class Px4Commander:
    """PX4's side: registrations, arming checks, modes and the fallback."""

    def __init__(self, bridge: Px4Bridge) -> None:
        self.bridge, self.now_ns = bridge, T0
        self.nav_state = self.intended = HOLD
        self.armed, self.landed, self.height = False, True, 0.0
        self.registered: dict[int, str] = {}
        self.configured = False
        self.can_run, self.events = False, [0]
        self.request_id, self.unanswered = 0, 0
        self.received: list[tuple[str, Any]] = []
        self.different = ""
        self.commanding = True

    def fly(self, seconds: float, *, throttle: float = HOVER, w: Any = (0.0, 0.0, 0.0)) -> None:
        """Let PX4, the bridge and, unless stopped, the MPC run for a time."""
        until = self.now_ns + round(seconds * SECOND)
        while self.now_ns < until:
            self.now_ns += STEP
            step = self.now_ns // STEP
            if step % 25 == 0:
                self.say_status()
            if step % 15 == 0 and self.registered:
                self.ask()
            mode = new_message("px4_msgs/msg/VehicleControlMode")
            ours = self.nav_state in self.registered
            mode.flag_armed = self.armed
            mode.flag_control_offboard_enabled = ours and self.configured
            self.say("vehicle_control_mode", mode)
            odometry = new_message("px4_msgs/msg/VehicleOdometry")
            odometry.timestamp = self.now_ns // 1000
            odometry.pose_frame = odometry.velocity_frame = 1
            odometry.q, odometry.position = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -self.height]
            self.say("vehicle_odometry", odometry)
            if self.commanding:
                made = command(self.now_ns, throttle, w=w)
                self.receive(self.bridge.receive_command(made, now_ns=self.now_ns))

    def say(self, topic: str, message: Any) -> None:
        deliver(self.bridge, f"/fmu/out/{topic}", message, self.now_ns)
        self.receive(self.bridge.take_outgoing())

    def say_status(self) -> None:
        status = new_message("px4_msgs/msg/VehicleStatus")
        status.nav_state, status.arming_state = self.nav_state, 2 if self.armed else 1
        status.nav_state_user_intention = self.intended
        status.pre_flight_checks_pass = self.can_run or self.intended not in self.registered
        status.can_set_nav_states_mask = sum(1 << each for each in (HOLD, *self.registered))
        self.say("vehicle_status_v4", status)
        land = new_message("px4_msgs/msg/VehicleLandDetected")
        land.landed = self.landed
        self.say("vehicle_land_detected", land)

    def ask(self) -> None:
        """Ask the mode whether it can run; without answers it is unresponsive."""
        self.unanswered += 1
        self.request_id = (self.request_id + 1) % 256
        request = new_message("px4_msgs/msg/ArmingCheckRequest")
        request.request_id = self.request_id
        self.say("arming_check_request", request)
        if self.unanswered > 4:
            self.can_run = False
        self.fall_back()

    def fall_back(self) -> None:
        if self.armed and self.nav_state in self.registered and not self.can_run:
            self.nav_state = RETURN
            self.say_status()

    def select(self, nav_state: int) -> bool:
        """Select a mode as a pilot does; in the air only one that can run."""
        if self.armed and nav_state in self.registered and not self.can_run:
            return False
        self.nav_state = self.intended = nav_state
        self.say_status()
        return True

    def arm(self) -> bool:
        if self.nav_state in self.registered and not self.can_run:
            return False
        self.armed = True
        self.say_status()
        return True

    def restart(self) -> None:
        self.__init__(self.bridge)  # type: ignore[misc]

    def receive(self, outgoing: list[Outgoing]) -> None:
        for each in outgoing:
            assert isinstance(each, OutgoingMessage)
            name = each.topic.name.removeprefix("/fmu/in/")
            assert each.message.timestamp == 0
            self.received.append((name, each.message))
            getattr(self, f"on_{name}")(each.message)

    def on_register_ext_component_request(self, message: Any) -> None:
        assert not self.armed, "PX4 registers only while disarmed"
        assert message.register_mode and message.register_arming_check
        if self.unanswered > 4 and self.intended not in self.registered:
            self.registered.clear()  # unresponsive, and not selected
        reply = new_message("px4_msgs/msg/RegisterExtComponentReply")
        reply.request_id, reply.name = message.request_id, message.name
        reply.success, reply.px4_ros2_api_version = True, 1
        reply.mode_id = MODE + len(self.registered)
        reply.arming_check_id, reply.mode_executor_id = 3, -1
        self.registered[reply.mode_id] = text_of(message.name)
        self.say("register_ext_component_reply", reply)

    def on_unregister_ext_component(self, message: Any) -> None:
        assert self.registered[message.mode_id] == text_of(message.name)
        assert (message.arming_check_id, message.mode_executor_id) == (3, -1)
        del self.registered[message.mode_id]

    def on_config_control_setpoints(self, message: Any) -> None:
        assert message.source_id in self.registered
        assert message.flag_control_rates_enabled and message.flag_control_allocation_enabled
        assert message.flag_control_offboard_enabled and not message.flag_control_attitude_enabled
        self.configured = True

    def on_arming_check_reply(self, message: Any) -> None:
        assert (message.registration_id, message.request_id) == (3, self.request_id)
        self.unanswered, self.can_run = 0, message.can_arm_and_run
        self.events = [each.id for each in message.events[: message.num_events]]

    def on_message_format_request(self, message: Any) -> None:
        assert message.protocol_version == 1
        response = new_message("px4_msgs/msg/MessageFormatResponse")
        response.topic_name, response.protocol_version = message.topic_name, 1
        response.success = True
        topic = text_of(message.topic_name)
        response.message_hash = format_of(topic) + (topic == self.different)
        self.say("message_format_response", response)

    def on_vehicle_rates_setpoint(self, message: Any) -> None:
        assert self.nav_state in self.registered, "a setpoint in another mode"
        assert self.configured

    def on_vehicle_command(self, message: Any) -> None:
        if message.command == 400:
            self.armed = message.param1 == 1.0
        else:
            main, sub = message.param2, message.param3
            assert (message.param1, main) == (1.0, 4.0)
            self.select(HOLD if sub == 3.0 else round(sub) - 11 + MODE)

    def on_mode_completed(self, message: Any) -> None:
        assert (message.result, message.nav_state) == (0, self.nav_state)

    def count(self, topic: str) -> int:
        return [name for name, _ in self.received].count(topic)


@pytest.fixture
def px4() -> Px4Commander:
    return Px4Commander(ExternalModeBridge(Px4Bridge.Config(mode="external"), new_message))


def flying(px4: Px4Commander) -> Px4Commander:
    """Select the mode on the ground, arm and take off."""
    px4.fly(3.0, throttle=0.0)
    assert px4.select(MODE)
    px4.fly(1.0, throttle=0.0)
    assert px4.bridge.handover[0] == "standby"
    assert px4.arm()
    px4.fly(0.5, throttle=0.0)
    px4.landed = False
    px4.fly(1.5)
    assert px4.bridge.engaged(now_ns=px4.now_ns)
    return px4


def test_registers_the_mode_by_name_and_sends_no_setpoints(px4: Px4Commander) -> None:
    px4.fly(6.0, throttle=0.0)
    assert px4.registered == {MODE: "quad MPC"}
    assert px4.count("register_ext_component_request") == 1
    assert px4.count("vehicle_rates_setpoint") == px4.count("vehicle_command") == 0
    assert px4.can_run
    assert px4.bridge.stack_fault(now_ns=px4.now_ns) == ""


def test_selecting_the_mode_engages_and_arming_flies(px4: Px4Commander) -> None:
    flying(px4)
    px4.select(HOLD)
    px4.fly(0.1)
    assert px4.bridge.handover[0] == "released"
    before = px4.count("vehicle_rates_setpoint")
    px4.fly(1.0)
    assert px4.count("vehicle_rates_setpoint") == before
    assert px4.select(MODE)  # in the air
    px4.fly(0.5)
    assert px4.bridge.engaged(now_ns=px4.now_ns)


def test_the_service_engage_selects_the_mode(px4: Px4Commander) -> None:
    px4.fly(3.0, throttle=0.0)
    assert px4.bridge.engage(True, now_ns=px4.now_ns).accepted
    px4.fly(1.0, throttle=0.0)
    assert px4.nav_state == MODE
    assert px4.bridge.handover[0] == "standby"


def test_px4_refuses_arming_with_the_reason(px4: Px4Commander) -> None:
    px4.commanding = False
    px4.fly(3.0)
    assert px4.select(MODE)
    px4.fly(1.0)
    assert not px4.arm()
    assert px4.events == [UNRESPONSIVE]
    assert any("no fresh command" in each for each in px4.bridge.take_warnings())
    px4.commanding = True
    px4.fly(1.0, throttle=0.0, w=(3.0, 0.0, 0.0))
    assert not px4.arm()
    assert px4.events == [DENIED]
    px4.fly(1.0, throttle=0.0)
    assert px4.arm()


def test_px4_cannot_arm_before_the_handover(px4: Px4Commander) -> None:
    px4.commanding = False
    px4.fly(3.0)
    assert px4.select(MODE)
    px4.fly(0.5)
    px4.commanding = True
    px4.now_ns -= px4.now_ns % (SECOND // 2)  # the next status comes in half a second
    px4.fly(0.1, throttle=0.0)
    px4.ask()
    assert px4.bridge.handover[0] == "released"
    assert not px4.arm()
    px4.fly(1.0, throttle=0.0)
    assert px4.bridge.handover[0] == "standby"
    assert px4.arm()


def test_requests_hold_when_commands_stop(px4: Px4Commander) -> None:
    flying(px4)
    px4.commanding, stopped_ns = False, px4.now_ns
    while px4.nav_state == MODE:
        px4.fly(0.02)
    assert 0.5 * SECOND < px4.now_ns - stopped_ns < 0.6 * SECOND
    assert px4.nav_state == px4.intended == HOLD
    # The MPC returns: the flight does not resume.
    px4.commanding = True
    px4.fly(3.0)
    assert px4.nav_state == HOLD
    assert px4.bridge.handover == (
        "released",
        "released after 0.52 s without a fresh command: select the mode quad MPC",
    )
    assert px4.select(MODE)
    px4.fly(0.5)
    assert px4.bridge.engaged(now_ns=px4.now_ns)


def test_values_that_are_not_finite_end_the_flight(px4: Px4Commander) -> None:
    flying(px4)
    px4.fly(1.0, throttle=math.nan)
    assert px4.nav_state == HOLD


def test_px4_flies_back_and_stays_there_if_hold_is_refused(px4: Px4Commander) -> None:
    flying(px4)
    px4.on_vehicle_command = lambda message: None  # type: ignore[method-assign]
    px4.commanding = False
    px4.fly(1.0)
    assert px4.nav_state == RETURN
    px4.commanding = True
    px4.fly(5.0)
    assert not px4.can_run, "PX4 would resume the mode that the pilot has selected"


def test_does_not_resume_after_the_link_was_cut(px4: Px4Commander) -> None:
    flying(px4)
    px4.nav_state = RETURN  # PX4's failsafe
    px4.now_ns += 3 * SECOND
    px4.now_ns -= px4.now_ns % (SECOND // 2)  # the next status comes in half a second
    px4.fly(0.25)
    px4.ask()
    assert not px4.can_run
    px4.fly(2.0)
    assert not px4.can_run


def test_does_not_take_a_mode_back_from_the_pilot(px4: Px4Commander) -> None:
    flying(px4)
    before = px4.count("vehicle_command")
    for nav_state in (0, 2, 10):
        px4.nav_state = px4.intended = nav_state  # without a status yet
        px4.fly(2.0)
        assert px4.nav_state == nav_state
    assert px4.count("vehicle_command") == before


def test_landing_completes_the_mode_and_arming_flies_again(px4: Px4Commander) -> None:
    flying(px4)
    px4.landed = True
    px4.fly(1.0, throttle=0.0)
    assert px4.count("mode_completed") == 1
    px4.armed = False  # by PX4
    px4.fly(1.0, throttle=0.0)
    assert px4.bridge.handover[0] == "standby"  # the mode is still selected
    assert px4.arm()
    px4.fly(0.1, throttle=0.0)
    assert px4.bridge.engaged(now_ns=px4.now_ns)


def test_registers_again_after_px4_has_restarted(px4: Px4Commander) -> None:
    px4.fly(3.0, throttle=0.0)
    px4.restart()
    px4.now_ns += 20 * SECOND
    px4.fly(3.0, throttle=0.0)
    assert px4.registered == {MODE: "quad MPC"}
    assert px4.can_run


def test_registers_again_after_the_bridge_was_killed_in_flight(px4: Px4Commander) -> None:
    """PX4 keeps the mode while it is selected, and would give a second one another place."""
    flying(px4).bridge = ExternalModeBridge(Px4Bridge.Config(mode="external"), new_message)
    px4.fly(3.0)
    assert px4.nav_state == RETURN
    px4.armed, px4.landed, px4.nav_state = False, True, px4.intended
    px4.fly(6.0, throttle=0.0)
    assert (px4.nav_state, px4.registered) == (HOLD, {MODE: "quad MPC"})
    assert px4.select(MODE)
    px4.fly(1.0, throttle=0.0)
    assert px4.arm()


def test_leaves_the_list_of_modes_at_the_end(px4: Px4Commander) -> None:
    flying(px4)
    assert px4.bridge.leave is not None
    px4.receive([*px4.bridge.leave()])
    assert (px4.nav_state, px4.registered) == (HOLD, {})


@pytest.mark.parametrize(
    ("fields", "reason", "requests"),
    [
        ({"success": False}, "PX4 refuses to register the mode quad MPC: no free place", 3),
        ({"px4_ros2_api_version": 2}, "version 2 of its protocol, expected 1", 1),
    ],
)
def test_reports_a_refused_registration(
    px4: Px4Commander, fields: dict[str, Any], reason: str, requests: int
) -> None:
    say = px4.say

    def refusing(topic: str, message: Any) -> None:
        if topic == "register_ext_component_reply":
            for name, value in fields.items():
                setattr(message, name, value)
        px4.registered.clear()
        say(topic, message)

    px4.say = refusing  # type: ignore[method-assign]
    px4.fly(5.0)
    assert reason in px4.bridge.stack_fault(now_ns=px4.now_ns)
    assert px4.count("register_ext_component_request") == requests
    assert px4.count("config_control_setpoints") == 0


def test_names_messages_that_differ_from_px4(px4: Px4Commander) -> None:
    px4.different = "/fmu/out/vehicle_status"
    px4.fly(3.0)
    fault = px4.bridge.stack_fault(now_ns=px4.now_ns)
    assert "px4_msgs" in fault and "VehicleStatus" in fault and "VehicleOdometry" not in fault


def test_px4_msgs_without_the_messages_of_modes_are_left_to_the_node() -> None:
    def old(type_name: str) -> Any:
        if "ExtComponent" in type_name:
            raise AttributeError(type_name)
        return new_message(type_name)

    bridge = ExternalModeBridge(Px4Bridge.Config(mode="external"), old)
    assert "px4_msgs/msg/UnregisterExtComponent" in {t.type_name for t in bridge.publications}


def test_ignores_the_reply_to_another_component(px4: Px4Commander) -> None:
    reply = new_message("px4_msgs/msg/RegisterExtComponentReply")
    reply.success, reply.mode_id, reply.px4_ros2_api_version = True, 25, 1
    reply.name = [*b"quad MPC".ljust(25, b"\0")]
    px4.say("register_ext_component_reply", reply)
    assert px4.received == []
    px4.fly(3.0)
    assert px4.registered == {MODE: "quad MPC"}


RECORDING = Path(__file__).with_name("recordings") / "px4_1.16_external.jsonl"


def replayed() -> tuple[list[tuple[float, str, Any]], Px4Bridge]:
    """Return what the bridge sends during a recording of PX4 1.16, apart from setpoints.

    The ground station selects the mode, arms, selects Hold and the mode again in the air, and
    the vehicle lands. Each state is answered by a command of the MPC.
    """
    bridge = ExternalModeBridge(Px4Bridge.Config(mode="external"), new_message)
    receive = {each.topic.type_name: each.receive for each in bridge.subscriptions}
    sent: list[tuple[float, str, Any]] = []
    armed = flies = False
    for line in RECORDING.read_text().splitlines():
        time, kind, fields = json.loads(line)
        now_ns = T0 + round(time * SECOND)
        message = new_message(f"px4_msgs/msg/{kind}")
        for name, value in fields.items():
            if isinstance(value, str):
                value = [*value.encode().ljust(len(getattr(message, name)), b"\0")]
            setattr(message, name, value)
        if kind == "RegisterExtComponentReply":
            message.request_id = [each.request_id for _, name, each in sent if "regist" in name][
                -1
            ]
        if kind == "MessageFormatResponse":
            message.message_hash = format_of(text_of(message.topic_name))
        receive[f"px4_msgs/msg/{kind}"](message, now_ns)
        outgoing = bridge.take_outgoing()
        if kind == "VehicleStatus":
            armed = message.arming_state == 2
        if kind == "VehicleOdometry":
            flies = armed and message.position[2] < -0.5
        made = command(now_ns, HOVER if flies else 0.0)
        outgoing += bridge.receive_command(made, now_ns=now_ns)
        for each in outgoing:
            assert isinstance(each, OutgoingMessage)
            sent.append((time, each.topic.name.removeprefix("/fmu/in/"), each.message))
    return sent, bridge


def test_a_recording_of_px4_is_answered_as_px4_expects() -> None:
    sent, bridge = replayed()
    names = [name for _, name, _ in sent]
    # PX4 was asked before the recording began, and answers each request once.
    assert names.count("register_ext_component_request") == 1
    assert names.count("message_format_request") == 9
    assert bridge.stack_fault(now_ns=T0 + 35 * SECOND) == ""
    requests = sum('"ArmingCheckRequest"' in line for line in RECORDING.read_text().splitlines())
    answers = [message for _, name, message in sent if name == "arming_check_reply"]
    assert requests > 100
    assert len(answers) == requests
    assert [each.registration_id for each in answers] == [0] * requests
    (completed,) = [message for _, name, message in sent if name == "mode_completed"]
    assert completed.nav_state == MODE
    assert "vehicle_command" not in names
    # Selected on the ground at 1.1 s, in Hold from 17.3 to 20.3 s, disarmed by PX4 at 35.4 s.
    setpoints = [time for time, name, _ in sent if name == "vehicle_rates_setpoint"]
    assert setpoints[0] < 1.5
    assert not [time for time in setpoints if 17.5 < time < 20.2]
    assert [time for time in setpoints if 20.4 < time < 35.3]
    assert bridge.handover[0] == "standby"
    refused = [time for time, name, message in sent if "reply" in name and message.num_events]
    assert [time < 1.5 or time > 35.3 for time in refused] == [True, True]  # until a handover
