# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the plant ``rotors`` with ROSflight's firmware and the bridge, in steps.

The bridge's messages become the firmware's MAVLink here as rosflight_io makes them. Acceleration
and rates go in, outputs of motors come out; a pilot holds the transmitter.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fixtures.fake_stacks import ENU_FROM_NED, FRD_FROM_FLU, set_stamp, wxyz_of_ned_frd
from fixtures.firmware_plant import (
    LEMNISCATE,
    MILLISECOND,
    FirmwarePlant,
    LiveFlight,
    bridged,
    configured,
    errors,
    flown,
)
from fixtures.rosflight_firmware import (
    HEARTBEAT,
    OFFBOARD,
    PARAM_VALUE,
    STATUS,
    Firmware,
    executable,
    fill_status,
    offboard,
    parameter,
)
from fixtures.stack_messages import new_message

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.bridges.rosflight import RosflightBridge
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.ros.bridges.bridge import OutgoingMessage
from quad_mpc_ros.simulation.config import SimulatorConfig

VEHICLE = "vehicles/paper"
RC_MAX_THR = 0.7
STRONGER = {"PID_ROLL_RATE_P": 0.2, "PID_PITCH_RATE_P": 0.2}


@pytest.fixture(scope="module", autouse=True)
def _needs() -> None:
    executable()


def sticks(*, throttle: float, yaw: float = 0.5, roll: float = 0.5, override: bool = False) -> Any:
    """Return the channels of a transmitter, 0 to 1."""
    return [roll, 0.5, throttle, yaw, 1.0 if override else 0.0, 0.0, 0.0, 0.0]


LOW, FULL = sticks(throttle=0.0), sticks(throttle=1.0)
ARMING, DISARMING = sticks(throttle=0.0, yaw=1.0), sticks(throttle=0.0, yaw=0.0)


class Bridged(FirmwarePlant):
    """The plant under ROSflight's loop and mixer."""

    def __init__(
        self, config: SimulatorConfig, *, rc_rate: float = 400.0, settings: Any = None
    ) -> None:
        given = {"mass": config.mass, "thrust_curve": config.thrust_curve}
        bridge = RosflightBridge(RosflightBridge.Config.build(given), new_message)
        self.receivers = {each.topic.name: each.receive for each in bridge.subscriptions}
        self.firmware = Firmware()
        self.is_cut = False
        self.pilot: Any = LOW
        self.statuses: list[Any] = []
        self.asked: dict[str, Any] = {}
        # By a clock of its own, so that frames come at any time after a command.
        self.rc_per_step = 0.997e-3 * rc_rate
        super().__init__(config, bridge)
        self.firmware.send(HEARTBEAT, bytes((0, 0, 0, 0, 0, 0, 0, 0, 3)))
        for name, value in {"PRIMARY_MIXER": 2, "FAILSAFE_THR": 0.2, **(settings or {})}.items():
            self.firmware.set_parameter(name, value)

    def close(self) -> None:
        self.firmware.close()

    def _send(self, outgoing: OutgoingMessage | bytes) -> None:
        assert isinstance(outgoing, OutgoingMessage)
        if not self.is_cut:
            self.firmware.send(OFFBOARD, offboard(outgoing.message))

    def _send_odometry(self, truth: OdometrySample) -> None:
        message = new_message("roscopter_msgs/msg/State")
        set_stamp(message, truth.stamp_ns)
        message.p_n, message.p_e, message.p_d = map(float, ENU_FROM_NED.T @ truth.p_WB)
        message.v_x, message.v_y, message.v_z = map(float, FRD_FROM_FLU @ truth.v_WB_B)
        message.p, message.q, message.r = map(float, FRD_FROM_FLU @ truth.w_WB_B)
        q = message.quat
        q.w, q.x, q.y, q.z = map(float, wxyz_of_ned_frd(truth))
        self.receivers["/estimated_state"](message, self.now_ns)

    def _levels(self, force_B: Array, w_WB_B: Array) -> Any:
        passed = self.passed_ns // MILLISECOND
        is_due = int(passed * self.rc_per_step) > int((passed - 1) * self.rc_per_step)
        channels = self.pilot if is_due and self.pilot else None
        said = self.firmware.step(
            1000 + 1000 * passed, force_B=force_B, w_WB_B=w_WB_B, channels=channels
        )
        if channels is not None:
            self.receivers["/rc_raw"](new_message("rosflight_msgs/msg/RCRaw"), self.now_ns)
        for number, payload in said:
            if number == STATUS[0]:
                status = new_message("rosflight_msgs/msg/Status")
                fill_status(status, payload)
                self.statuses.append(status)
                self.receivers["/status"](status, self.now_ns)
            if number == PARAM_VALUE[0]:
                name, value = parameter(payload)
                if name in self.asked:
                    self.asked.pop(name)(SimpleNamespace(exists=True, value=value))
        return self.firmware.outputs

    def calibrate(self) -> None:
        self.firmware.calibrate()
        self.live(1.5)

    def arm(self, live: Any) -> None:
        """Arm by the sticks and raise the throttle, with idle commands."""
        self.pilot = ARMING
        live(1.2)
        self.pilot = FULL
        live(1.2)  # RC_OVRD_LAG_T after the last deviation of a stick
        assert self.bridge.handover[0] == "engaged"

    def engage(self) -> None:
        """Engage, and pass its questions on as rosflight_io does."""
        answer = self.bridge.engage(True, now_ns=self.now_ns)
        assert answer.accepted, answer.text
        for call in answer.calls:
            assert (call.service, call.type_name) in self.bridge.services and call.optional
            self.asked[call.request.name] = call.receive
            self.firmware.ask_parameter(call.request.name)

    def take_over(self, throttle: float) -> None:
        self.calibrate()
        self.live(0.1, 0.0)
        self.engage()
        self.arm(lambda seconds: self.live(seconds, 0.0))
        self.live(0.3, throttle)
        self.is_held = False


def vehicle(*assignments: str, **mpc: Any) -> FlightConfig:
    return configured(VEHICLE, *assignments, throttle_max=RC_MAX_THR, **mpc)


HOVER = vehicle().simulator.initial_throttle


def test_signs_of_all_axes() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        for w in np.vstack((np.eye(3), -np.eye(3))):
            before = plant.odometry(0).w_WB_B
            plant.live(0.3, HOVER, w)
            turned = float((plant.odometry(0).w_WB_B - before) @ w)
            assert turned > 0.2 if w[2] else turned == pytest.approx(1.0, abs=0.02)


def test_parameters_of_the_firmware_are_read_when_it_is_engaged() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        assert plant.asked == {}
        assert any("TAKE_MIN_THR is 1" in each for each in plant.warnings)
        assert any("PID_ROLL_RATE_I is 0" in each for each in plant.warnings)


def test_wrong_rc_max_throttle_releases_before_take_off() -> None:
    with bridged(Bridged, vehicle(), settings={"RC_MAX_THR": 0.9}) as plant:
        plant.calibrate()
        plant.live(0.1, 0.0)
        plant.engage()
        plant.live(0.1, 0.0)
        state, reason = plant.bridge.handover
        assert state == "released" and "RC_MAX_THR is 0.9 and rc_max_throttle 0.7" in reason


def test_without_rc_frames_the_last_command_is_held() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.live(0.4, HOVER, (0.5, 0.0, 0.0))
        plant.pilot = None
        plant.live(0.4, HOVER, (-0.5, 0.0, 0.0))
        assert plant.odometry(0).w_WB_B[0] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("taking", [{"override": True}, {"roll": 0.8}], ids=str)
def test_a_pilot_takes_over_by_switch_or_stick(taking: Any) -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.live(0.2, HOVER)
        plant.pilot = sticks(throttle=0.5, **taking)
        plant.statuses.clear()
        plant.live(0.3, HOVER)
        first = plant.statuses[0]
        assert first.rc_override and first.offboard  # which says that commands come, no more
        assert plant.bridge.handover[0] == "released"


def test_a_lost_receiver_levels_at_the_throttle_of_failsafe() -> None:
    with bridged(Bridged, vehicle(), settings={"FAILSAFE_THR": 0.4}) as plant:
        plant.take_over(HOVER)
        plant.live(0.4, HOVER, (0.5, 0.0, 0.0))
        plant.pilot = sticks(throttle=0.5, roll=-0.5)  # a pulse that no receiver gives
        plant.live(1.5, HOVER)
        assert plant.bridge.handover[0] == "released" and "failsafe" in plant.bridge.handover[1]
        assert plant.odometry(0).up > 0.99
        assert np.mean(plant.firmware.outputs[:4]) == pytest.approx(0.4 * RC_MAX_THR, abs=0.01)


def test_reports_a_throttle_stick_that_caps_the_command() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.pilot = sticks(throttle=0.2)
        plant.live(1.0, HOVER)
        assert plant.v_WB_W[2] < -1.0
        assert plant.bridge.handover[0] == "engaged"
        assert any("TAKE_MIN_THR" in each for each in plant.warnings)


def test_lost_commands_return_control_to_the_pilot() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.live(0.4, HOVER, (0.5, 0.0, 0.0))
        plant.pilot = sticks(throttle=0.5)
        plant.live(0.12)
        assert plant.odometry(0).w_WB_B[0] < 0.4
        plant.live(1.0)
        assert plant.odometry(0).up > 0.99  # RC_ATT_MODE 1: his sticks are angles
        assert not plant.bridge.engaged(now_ns=plant.now_ns)


def test_take_off_lemniscate_landing_and_disarming() -> None:
    loaded = vehicle(
        "reference.trajectory=lemniscate",
        "reference.angular_frequency=1.0",
        "reference.takeoff_height=1.5",
    )
    with bridged(Bridged, vehicle(), 0.0) as plant:
        plant.is_held = False
        plant.calibrate()
        flight = LiveFlight(loaded, plant)
        flight.fly(0.5)
        plant.engage()
        plant.arm(flight.fly)
        assert max(flight.heights) < 0.1
        assert flight.live.take_off(plant.now_ns).accepted
        flight.fly(6.0)
        assert flight.heights[-1] == pytest.approx(1.5, abs=0.05)
        assert flight.live.start(plant.now_ns).accepted
        flight.fly(12.0)
        assert flight.error < 0.05
        assert flight.live.land(plant.now_ns).accepted
        flight.fly(10.0)
        assert flight.heights[-1] < 0.1
        plant.pilot = DISARMING
        flight.fly(1.5)
        assert max(plant.firmware.outputs) == 0.0
        assert plant.bridge.handover[0] == "released"


@pytest.mark.parametrize("rc_rate", [50.0, 400.0])
@pytest.mark.parametrize("settings", [{}, STRONGER], ids=["default gains", "P 0.2"])
@pytest.mark.parametrize(
    ("assignments", "most"),
    [
        (("reference.trajectory=hover",), 0.02),
        ((*LEMNISCATE, "reference.angular_frequency=1.0"), 0.05),
        ((*LEMNISCATE, "reference.angular_frequency=1.5"), 0.05),
    ],
)
def test_flies_with_guessed_lags(
    rc_rate: float, settings: Any, assignments: Any, most: float
) -> None:
    flight, _ = flown(
        vehicle(*assignments),
        lambda simulator: Bridged(simulator, rc_rate=rc_rate, settings=settings),
        duration=20.0,
    )
    assert np.sqrt(np.mean(errors(flight)[150:] ** 2)) < most
    assert flight.stats["thrust_scale"][-1] == pytest.approx(1.0, abs=0.05)
