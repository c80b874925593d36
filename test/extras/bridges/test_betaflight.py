# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bridge to Betaflight: rate curves, MSP frames, and the handover of the sticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from fixtures.betaflight import (
    ANGLE,
    ARM,
    FAILSAFE,
    MSP_OVERRIDE,
    analog,
    attitude,
    boxids,
    rc_tuning,
    requests,
    set_raw_rc,
    status,
)
from fixtures.bridges import HOVER, SECOND, T0, command, ready_to_fly
from fixtures.stack_messages import new_message, sound_message
from hypothesis import given
from hypothesis import strategies as st

from quad_mpc_ros.extras.bridges.betaflight import BetaflightBridge
from quad_mpc_ros.extras.bridges.betaflight.rates import RateCurve

MILLISECOND = 1_000_000
STEP = 10 * MILLISECOND


# Rates, in degrees a second, as configurators show them.
@pytest.mark.parametrize(
    ("curve", "stick", "expected"),
    [
        (RateCurve(kind="ACTUAL", rc_rate=7, super_rate=67, expo=0), 1.0, 670.0),
        (RateCurve(kind="ACTUAL", rc_rate=7, super_rate=67, expo=54), 1.0, 670.0),
        (RateCurve(kind="ACTUAL", rc_rate=20, super_rate=20, expo=0), 0.5, 100.0),
        (RateCurve(kind="BETAFLIGHT", rc_rate=100, super_rate=70, expo=0), 1.0, 666.667),
        (RateCurve(kind="BETAFLIGHT", rc_rate=100, super_rate=0, expo=0), 0.5, 100.0),
        (RateCurve(kind="BETAFLIGHT", rc_rate=100, super_rate=0, expo=100), 0.5, 12.5),
        (RateCurve(kind="QUICK", rc_rate=100, super_rate=67, expo=0), 1.0, 670.0),
        (RateCurve(kind="QUICK", rc_rate=100, super_rate=20, expo=0), 0.5, 100.0),
        (RateCurve(kind="ACTUAL", rc_rate=7, super_rate=250, expo=0, limit=1000.0), 1.0, 1000.0),
    ],
)
def test_curves_have_the_published_rates(curve: RateCurve, stick: float, expected: float) -> None:
    assert math.degrees(curve.rate(np.array([stick]))[0]) == pytest.approx(expected, rel=1e-4)


CURVES = st.builds(
    RateCurve,
    kind=st.sampled_from(("ACTUAL", "BETAFLIGHT", "QUICK")),
    rc_rate=st.integers(1, 200),
    super_rate=st.integers(1, 95),
    expo=st.integers(0, 90),
)


@given(CURVES, st.floats(-1.0, 1.0))
def test_pulse_for_a_rate_inverts_the_rate_curve(curve: RateCurve, share: float) -> None:
    """To what a microsecond of the stick changes; no pulse goes beyond the stick."""
    rate = share * float(curve.rate(np.array([1.0]))[0])
    pulse = curve.pulse(rate)
    assert 1000.0 <= pulse <= 2000.0
    made = math.copysign(curve.rate(np.array([abs(pulse - 1500.0) / 500.0]))[0], pulse - 1500.0)
    near = np.array([max(abs(pulse - 1500.0) - 1.0, 0.0), min(abs(pulse - 1500.0) + 1.0, 500.0)])
    step = float(np.diff(curve.rate(near / 500.0))[0])
    assert abs(made - rate) <= step + 1e-9


# The bridge.


class Controller:
    """A fake flight controller at the other end of a bridge's line."""

    def __init__(self, **parameters: Any) -> None:
        self.bridge = BetaflightBridge(BetaflightBridge.Config.build(parameters), new_message)
        self.now_ns = T0
        self.modes: Sequence[int] = ()
        self.blocks = 0
        self.tilt = 0.0, 0.0
        self.sends = True
        self.first = boxids() + rc_tuning()
        self.sticks: tuple[int, ...] = ()
        self.height = 2.0

    def live(self, seconds: float, *, throttle: float | None = None, w: Any = (0, 0, 0)) -> None:
        """Let time pass, with commands or without."""
        end_ns = self.now_ns + round(seconds * SECOND)
        while self.now_ns < end_ns:
            self.now_ns += STEP
            said = self.first + status(self.modes, self.blocks) + attitude(*self.tilt)
            self.first = b""
            out = self.bridge.exchange(said if self.sends else b"", now_ns=self.now_ns)
            message = sound_message("nav_msgs/msg/Odometry", self.now_ns)
            message.pose.pose.position.z = self.height
            self.bridge.subscriptions[0].receive(message, self.now_ns)
            if throttle is not None:
                sent = self.bridge.receive_command(
                    command(self.now_ns, throttle, w), now_ns=self.now_ns
                )
                out += b"".join(each for each in sent if isinstance(each, bytes))
            for self.sticks in set_raw_rc(out):
                pass

    def engage(self) -> Any:
        return self.bridge.engage(True, now_ns=self.now_ns)

    def arm(self, wanted: bool = True) -> Any:
        return self.bridge.arm(wanted, now_ns=self.now_ns)

    @property
    def state(self) -> str:
        return self.bridge.handover[0]

    @property
    def warnings(self) -> str:
        return "; ".join(self.bridge.take_warnings())


def flying(**parameters: Any) -> Controller:
    """Return one that the bridge alone has the sticks of, flown in the air by the MPC."""
    controller = Controller(receiver="bridge", **parameters)
    controller.modes = (ARM,)
    controller.live(0.2, throttle=HOVER)
    assert controller.engage().accepted
    controller.live(0.2, throttle=HOVER)
    assert controller.state == "engaged"
    return controller


def test_requests_modes_and_rates_before_state() -> None:
    bridge = BetaflightBridge(BetaflightBridge.Config(), new_message)
    asked = {number for number, _ in requests(bridge.exchange(b"", now_ns=T0))}
    assert asked == {119, 111, 200}
    bridge.exchange(boxids() + rc_tuning(), now_ns=T0)
    later = bridge.exchange(b"", now_ns=T0 + SECOND)
    assert {number for number, _ in requests(later)} == {101, 108, 110, 111, 200}


@pytest.mark.parametrize(
    ("w", "channel", "pulse"),
    [((3.0, 0, 0), 0, 1623), ((0, 3.0, 0), 1, 1623), ((0, 0, 3.0), 3, 1377)],
)
def test_sticks_have_the_rates_with_their_signs(w: Any, channel: int, pulse: int) -> None:
    controller = flying()
    controller.live(0.1, throttle=HOVER, w=w)
    expected = [1500, 1500, controller.sticks[2], 1500]
    expected[channel] = pulse  # 3 rad/s of 700 deg/s
    assert list(controller.sticks[:4]) == expected


def test_throttle_pulse_gives_the_motor_level_of_the_map() -> None:
    controller = flying(motor_idle=0.1, min_check=1100)
    controller.live(0.1, throttle=0.55)
    # 10 % at 1100 us and 100 % at 2000 us.
    assert controller.sticks[2] == 1100 + round(900 * (0.55 - 0.1) / 0.9)


def test_pilot_hands_over_and_takes_back_with_msp_override() -> None:
    controller = Controller(receiver="pilot")
    controller.modes = (ARM,)
    controller.live(0.2, throttle=HOVER, w=(1.0, 0, 0))
    assert controller.sticks[:4] == (1500, 1500, 1000, 1500)
    assert controller.engage().accepted
    controller.live(10.0, throttle=HOVER)  # whenever he likes
    assert controller.state == "offered"
    controller.modes = (ARM, MSP_OVERRIDE)
    controller.live(0.2, throttle=HOVER, w=(1.0, 0, 0))
    assert controller.state == "engaged" and controller.sticks[0] > 1500
    controller.modes = (ARM,)
    controller.live(0.2, throttle=HOVER, w=(1.0, 0, 0))
    assert controller.state == "released"
    controller.modes = (ARM, MSP_OVERRIDE)
    controller.live(1.0, throttle=HOVER, w=(1.0, 0, 0))
    assert controller.state == "released"
    assert controller.sticks[:4] == (1500, 1500, 1000, 1500)
    assert not controller.arm().accepted


def test_arms_with_low_throttle_before_mpc_commands() -> None:
    controller = Controller(receiver="bridge")
    controller.height = 0.0
    controller.live(0.3, throttle=0.05)
    assert controller.sticks[2] == 1000 and controller.sticks[4] == 1000
    assert not controller.arm().accepted  # engage first
    assert controller.engage().accepted
    controller.live(0.3, throttle=0.05)
    assert controller.state == "standby"
    assert controller.arm().accepted
    controller.live(0.3, throttle=0.05, w=(0.5, 0, 0))
    assert controller.sticks[:5] == (1500, 1500, 1000, 1500, 2000)
    controller.modes = (ARM,)
    controller.live(0.1, throttle=0.05)
    controller.live(0.2, throttle=HOVER, w=(0.5, 0, 0))
    assert controller.state == "engaged"
    assert controller.sticks[2] > 1050 and controller.sticks[0] > 1500


def test_failed_arming_is_reported_and_given_up() -> None:
    controller = Controller(receiver="bridge")
    controller.height, controller.blocks = 0.0, 1 << 9
    controller.live(0.3, throttle=0.05)
    controller.engage()
    controller.live(0.3, throttle=0.05)
    refused = controller.arm()
    assert not refused.accepted and "BOOTGRACE" in refused.text
    controller.blocks = 1 << 28  # the switch alone blocks nothing
    controller.live(0.1, throttle=0.05)
    assert controller.arm().accepted
    controller.blocks = 1 << 7
    controller.live(2.1, throttle=0.05)
    assert "has not armed: THROTTLE" in controller.warnings
    assert controller.sticks[4] == 1000


def test_lost_commands_lead_to_level_descent_and_disarming() -> None:
    controller = flying(**{"lost.duration": 1.0, "lost.thrust": 0.8})
    controller.arm()  # as it would have been armed
    controller.live(0.05, throttle=HOVER, w=(2.0, 0, 0))
    held = controller.sticks
    controller.live(0.1)
    assert controller.sticks == held
    controller.tilt = 20.0, -10.0
    controller.live(0.2)
    assert controller.sticks[0] < 1500 < controller.sticks[1]
    assert controller.sticks[3] == 1500 and controller.sticks[4] == 2000
    vehicle = controller.bridge._config.vehicle()
    weight = vehicle.mass * vehicle.gravity
    level = 0.055 + 0.945 * (controller.sticks[2] - 1050) / 950
    assert vehicle.thrust(level) == pytest.approx(0.8 * weight, rel=0.02)
    assert "descending level" in controller.warnings
    controller.live(1.0)
    assert controller.sticks[:5] == (1500, 1500, 1000, 1500, 1000)
    controller.modes = ()
    controller.live(0.2, throttle=HOVER)
    assert controller.state == "released" and controller.sticks[2] == 1000


def test_continues_after_a_short_gap() -> None:
    controller = flying()
    controller.live(0.3)
    controller.live(0.1, throttle=HOVER, w=(1.0, 0, 0))
    assert controller.state == "engaged" and controller.sticks[0] > 1500


def test_release_in_flight_leads_to_level_descent() -> None:
    controller = flying()
    controller.tilt = 10.0, 0.0
    controller.bridge.engage(False, now_ns=controller.now_ns)
    controller.live(0.3, throttle=HOVER)
    assert controller.sticks[0] < 1500 and controller.sticks[2] > 1050


def test_keeps_attitude_without_telemetry() -> None:
    controller = flying()
    controller.tilt = 20.0, 0.0
    controller.live(0.1, throttle=HOVER)
    controller.sends = False
    controller.live(1.0)
    assert controller.sticks[:2] == (1500, 1500)


def test_does_not_arm_again_after_the_stack_disarmed() -> None:
    controller = flying()
    controller.arm()
    controller.live(0.1, throttle=HOVER)
    controller.modes = ()
    controller.live(0.2, throttle=HOVER)
    controller.live(0.2, throttle=HOVER)
    assert controller.state == "released"
    assert controller.sticks[:5] == (1500, 1500, 1000, 1500, 1000)


@pytest.mark.parametrize(
    ("modes", "reason"),
    [((ARM, FAILSAFE), "in failsafe"), ((ARM, ANGLE), "use acro"), ((ARM, 2), "use acro")],
)
def test_refuses_levelling_modes_and_failsafe(modes: Sequence[int], reason: str) -> None:
    controller = Controller(receiver="bridge")
    controller.modes = modes
    controller.live(0.2, throttle=HOVER)
    answer = controller.engage()
    assert not answer.accepted and reason in answer.text


def test_rates_of_an_unknown_kind_are_refused() -> None:
    controller = Controller(receiver="bridge")
    raceflight = bytearray(rc_tuning())
    raceflight[5 + 22] = 1
    raceflight[-1] ^= 3 ^ 1
    controller.first = boxids() + bytes(raceflight)
    controller.live(0.2, throttle=HOVER)
    answer = controller.engage()
    assert not answer.accepted and "RACEFLIGHT" in answer.text


def test_sends_neutral_sticks_without_commands() -> None:
    bridge = BetaflightBridge(BetaflightBridge.Config(), new_message)
    times = [
        now_ns
        for now_ns in range(T0, T0 + SECOND, 5 * MILLISECOND)
        if set_raw_rc(bridge.exchange(b"", now_ns=now_ns))
    ]
    assert max(np.diff(times)) <= 50 * MILLISECOND


def test_the_voltage_scales_the_thrust() -> None:
    bridge = ready_to_fly(BetaflightBridge, T0, thrust_map=_map(battery_voltage=16.0))
    assert bridge.thrust.battery_scale == pytest.approx(1.0)
    for second in range(1, 20):
        bridge.exchange(analog(14.0), now_ns=T0 + second * SECOND)
    assert bridge.thrust.battery_scale == pytest.approx((14.0 / 16.0) ** 2, rel=0.01)


def _map(**values: Any) -> Any:
    return BetaflightBridge.Config.build(
        {f"thrust_map.{name}": value for name, value in values.items()}
    ).thrust_map
