# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Invalid messages cause no exception in a bridge and no invalid output."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fixtures import crazyflie, mavlink
from fixtures.betaflight import set_raw_rc
from fixtures.bridges import BRIDGES, engage
from fixtures.fuzzing import ALL, leaves, spoil, value_at

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.bridges.crazyflie.line import CrazyflieLine
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    Response,
    ServiceCall,
)

New = Callable[[str], Any]
Sound = Callable[[str, int], Any]

SEED = 20
MESSAGES = 4_000
AGAIN = 20  # messages until it is engaged again
PER_BRIDGE = 500  # messages until the next configuration is taken
SECOND = 1_000_000_000

# Among 20 ms and again 20 ms: the clock is set, and jumps.
STEPS_NS = [0, 1, SECOND // 100, SECOND // 10, 2 * SECOND, 3600 * SECOND, -1, -SECOND // 20]
STEPS_NS += [-3600 * SECOND]

# Of each bridge what differs from its default parameters, one after the other.
VARIANTS: dict[str, list[dict[str, Any]]] = {
    "px4_bridge": [{}, {"thrust_map.kind": "quadratic"}],
    "mavros_bridge": [{}, {"thrust_map.kind": "linear"}],
    "mavlink_bridge": [
        {"odometry_topic": "stack_odom"},
        {"odometry_topic": "stack_odom", "thrust_map.kind": "table"},
    ],
    "rosflight_bridge": [{"thrust_map.kind": "table"}],
    "crazyswarm2_bridge": [{"thrust_map.kind": "linear"}],
    "rates_bridge": [
        {},
        {"thrust_unit": "newton", "body_frame": "frd", "angle_unit": "deg"},
        {"thrust_unit": "mps2"},
    ],
}


class Messages:
    """Makes messages: as they should be but for some fields, or for all of them."""

    def __init__(self, sound: Sound, seed: int) -> None:
        self.random = random.Random(seed)
        self._sound = sound

    def make(self, type_name: str, now_ns: int) -> Any:
        age_ns = self.random.choice((0, 0, 1, SECOND // 50, SECOND // 5))
        message = self._sound(type_name, now_ns - age_ns)
        spoil(message, self.random.choice((0, 0, 1, 1, 2, 3, ALL)), self.random)
        return message


class Clock:
    """The time of the node, which mostly passes."""

    def __init__(self, random: random.Random, *, at_once: float) -> None:
        self._random, self._at_once = random, at_once
        self.now_ns = 1_700_000_000 * SECOND

    def tick(self) -> int:
        step = 0 if self._random.random() < self._at_once else SECOND // 50
        if self._random.random() < 0.02:
            step = self._random.choice(STEPS_NS)
        self.now_ns += step
        return self.now_ns


def bridges(case: str, new: New) -> Iterator[Bridge]:
    """Yield the bridges of a case for ever, each as long as it is used."""
    battery = {"thrust_map.battery_voltage": 16.0}
    kind = BRIDGES[case]
    variants = VARIANTS.get(case, [{}])
    configs = [kind.Config.build({**battery, **changes}) for changes in variants]
    while True:
        for config in configs:
            yield kind(config, new)


def check_message(message: Any) -> None:
    """Every number is finite."""
    for path in leaves(message):
        value = value_at(message, path)
        if isinstance(value, float | np.ndarray):
            assert np.all(np.isfinite(value)), (path, value)


def check_response(response: Response) -> None:
    assert response.text
    for sending in response.messages:
        if isinstance(sending, bytes):
            assert sending
        else:
            check_message(sending.message)
    for call in response.calls:
        check_message(call.request)


def check_odometry(odometry: OdometrySample, bridge: Bridge, now_ns: int, new: New) -> None:
    """The MPC can compute with it, and it can be sent."""
    vectors = np.concatenate((odometry.p_WB, odometry.v_WB_B, odometry.w_WB_B))
    assert np.all(np.abs(vectors) <= 1e8)
    assert abs(np.linalg.norm(odometry.q_WB_xyzw) - 1.0) <= 1e-3
    assert (odometry.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert odometry.stamp_ns - now_ns <= SECOND // 10  # late it may be, and then it says so
    conversions.fill_odometry(new("nav_msgs/msg/Odometry"), odometry)


# rad/s and degrees/s that any vehicle could be asked for, throttle, and the thrust of all motors.
FASTEST, FASTEST_DEGREES, FULL_THRUST, MASS = 100.0, 5730.0, 18.8, 0.39


def check_bytes(data: bytes, case: str) -> None:
    if case == "mavlink_bridge":
        for setpoint in mavlink.setpoints(data):
            assert max(map(abs, setpoint.rates)) <= FASTEST and 0.0 <= setpoint.thrust <= 1.0
    else:
        (pulses,) = set_raw_rc(data)
        assert all(1000 <= pulse <= 2000 for pulse in pulses)


def check_sendings(sendings: list[Outgoing], case: str, bridge: Bridge) -> None:
    """Finite, and what the stack's message can mean."""
    for sending in sendings:
        if isinstance(sending, ServiceCall):
            assert (sending.service, sending.type_name) in bridge.services
            check_message(sending.request)
            continue
        if isinstance(sending, bytes) and isinstance(bridge.line, CrazyflieLine):
            for *degrees, pwm in crazyflie.setpoints(sending):
                # The heading of a vehicle that points up or down turns faster than its body.
                assert max(map(abs, degrees)) <= 4.0 * FASTEST_DEGREES and pwm <= 60000
            continue
        if isinstance(sending, bytes):
            check_bytes(sending, case)
            continue
        assert sending.topic in bridge.publications
        message = sending.message
        check_message(message)
        match sending.topic.type_name:
            case "px4_msgs/msg/VehicleRatesSetpoint":
                rates, thrust, most = (message.roll, message.pitch, message.yaw), 0.0, FASTEST
                assert -1.0 <= message.thrust_body[2] <= 0.0
            case "mavros_msgs/msg/AttitudeTarget":
                w = message.body_rate
                rates, thrust, most = (w.x, w.y, w.z), message.thrust, FASTEST
            case "rosflight_msgs/msg/Command":
                rates, thrust, most = tuple(message.u[3:6]), message.u[2], FASTEST
            case "as2_msgs/msg/Thrust":
                rates, thrust, most = (0.0,), message.thrust / FULL_THRUST, FASTEST
            case "geometry_msgs/msg/Twist":
                rates = (message.linear.x, message.linear.y, message.angular.z)
                thrust, most = message.linear.z / 60000.0, FASTEST_DEGREES
            case "geometry_msgs/msg/TwistStamped":
                w, z = message.twist.angular, message.twist.linear.z
                rates, most = (w.x, w.y, w.z), FASTEST_DEGREES
                thrust = abs(z) / (FULL_THRUST / MASS)
                frd = getattr(bridge._config, "body_frame", "flu") == "frd"
                assert z == 0.0 or (z < 0.0) is frd
            case _:
                continue
        assert max(map(abs, rates)) <= most
        assert 0.0 <= thrust <= 1.0


class Run:
    """Thousands of messages to one bridge after another; a failure names the seed."""

    def __init__(self, case: str, new: New, sound: Sound, *, again: bool = False) -> None:
        self.case, self.new, self.again = case, new, again
        self.messages = Messages(sound, SEED)
        self.random = self.messages.random
        # A pose and its twist are of the same time.
        self.clock = Clock(self.random, at_once=0.8 if case == "aerostack2_bridge" else 0.2)
        self.number = 0
        self.bridge: Bridge

    def __iter__(self) -> Iterator[int]:
        """Yield the time of each message, with ``bridge`` set."""
        made = bridges(self.case, self.new)
        for self.number in range(MESSAGES):
            if self.number % PER_BRIDGE == 0:
                self.bridge = next(made)
                self.ready()
            elif self.again and self.number % AGAIN == 0:
                self.ready()
            yield self.clock.tick()

    def ready(self) -> None:
        """Let the stack be as it is when it takes setpoints, as far as a service brings it."""
        with np.errstate(all="ignore"):
            engage(self.bridge, self.clock.now_ns)

    def failed(self, error: BaseException, message: Any) -> AssertionError:
        values = {".".join(path): value_at(message, path) for path in leaves(message)}
        return AssertionError(
            f"{self.case}, seed {SEED}, message {self.number} ({type(message).__name__}): "
            f"{error!r}: {values}"
        )


@pytest.mark.parametrize("case", BRIDGES)
def test_no_state_message_breaks_a_bridge(case: str, new: New, sound: Sound) -> None:
    run = Run(case, new, sound)
    passed = 0
    for now_ns in run:
        bridge = run.bridge
        subscription = bridge.subscriptions[run.number % len(bridge.subscriptions)]
        with np.errstate(all="ignore"):  # what comes of it is refused
            message = run.messages.make(subscription.topic.type_name, now_ns)
            try:
                odometry = subscription.receive(message, now_ns)
                if odometry is not None:
                    passed += 1
                    check_odometry(odometry, bridge, now_ns, new)
                assert bridge.engaged(now_ns=now_ns) in (True, False)
                assert 0.5 <= bridge.thrust.battery_scale <= 1.5
                assert all(isinstance(text, str) for text in bridge.take_warnings())
            except Exception as error:
                raise run.failed(error, message) from error
    assert passed > MESSAGES // 50  # else little more than the front door was tried


@pytest.mark.parametrize("case", BRIDGES)
def test_bridges_never_send_invalid_values(case: str, new: New, sound: Sound) -> None:
    run = Run(case, new, sound, again=True)
    sent = 0
    for now_ns in run:
        bridge = run.bridge
        with np.errstate(all="ignore"):
            for subscription in bridge.subscriptions:
                if run.random.random() < 0.1:
                    state = run.messages.make(subscription.topic.type_name, now_ns)
                    subscription.receive(state, now_ns)
            message = run.messages.make("geometry_msgs/msg/TwistStamped", now_ns)
        try:
            command = conversions.command_from_message(message)
            sendings = bridge.receive_command(command, now_ns=now_ns)
            check_sendings(sendings, case, bridge)
            if sendings:
                sent += 1
                assert abs(now_ns - command.stamp_ns) <= SECOND // 10
            else:
                assert bridge.silence
            if run.random.random() < 0.05:
                wish = run.random.choice((bridge.arm, bridge.engage))
                check_response(wish(run.random.random() < 0.8, now_ns=now_ns))
        except Exception as error:
            raise run.failed(error, message) from error
    assert sent > MESSAGES // 20
