# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Betaflight bridge: handover of the sticks, arming, and loss of commands.

The bridge always sends sticks: the MPC's, neutral, or, if the MPC's commands stop in flight,
sticks for a level descent, then stop and disarm. Betaflight 4.5 and 2025.12 hold the last MSP
sticks indefinitely.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.extras.bridges.betaflight.lines import (
    ANGLE,
    ARM,
    FAILSAFE,
    HORIZON,
    MSP_OVERRIDE,
    BetaflightTelemetry,
    MspProtocol,
)
from quad_mpc_ros.extras.bridges.betaflight.rates import RATE_KINDS
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    Response,
)
from quad_mpc_ros.ros.bridges.config import EstimatorConfig
from quad_mpc_ros.ros.bridges.handover import HandoverState, Stack, is_old
from quad_mpc_ros.ros.bridges.line import line_to

_SECOND = 1_000_000_000
_RC_PERIOD_NS = 50_000_000  # sticks at least so often; Betaflight counts 150 ms as a loss
_TELEMETRY_PERIOD_NS = _SECOND // 2
_ARM_LIMIT_NS = 2 * _SECOND
_STICK_LOW, _STICK_MIDDLE, _STICK_HIGH = 1000.0, 1500.0, 2000.0
_ROLL, _PITCH, _THROTTLE, _YAW = range(4)

# Blocks that pass by themselves while nothing arms: the switch after a refusal.
_TRANSIENT_BLOCKS = frozenset(("ARM_SWITCH",))

_Rates = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class BetaflightLossParameters(Configuration):
    """Behaviour if the MPC's commands stop in flight."""

    owner = "lost"

    after: float = parameter(
        0.15,
        doc="Time without commands after which the commands count as lost.",
        unit="s",
        above=0.0,
        maximum=0.5,
    )
    thrust: float = parameter(
        0.85, doc="Thrust-to-weight ratio of the level descent.", minimum=0.0, maximum=1.0
    )
    duration: float = parameter(
        3.0, doc="Duration of the descent before disarming.", unit="s", minimum=0.0, maximum=60.0
    )
    level_gain: float = parameter(
        4.0, doc="Gain from tilt to commanded body rate.", unit="1/s", minimum=0.0, maximum=20.0
    )


@dataclass(frozen=True, kw_only=True)
class BetaflightConfig(EstimatorConfig):
    """Parameters of the Betaflight bridge."""

    owner = "betaflight_bridge"

    device: str = parameter("/dev/ttyAMA0", doc="Serial port to the flight controller.")
    baud: int = parameter(
        115200, doc="Baud rate of the serial port.", unit="bit/s", minimum=9600, maximum=4000000
    )
    receiver: str = parameter(
        "pilot",
        doc="pilot: the pilot arms with the transmitter and hands over control with the mode "
        "MSP OVERRIDE. bridge: the bridge is the only receiver and arms.",
        choices=("pilot", "bridge"),
    )
    arm_channel: int = parameter(
        5, doc="receiver bridge: channel that arms when high.", minimum=5, maximum=16
    )
    motor_idle: float = parameter(
        0.055,
        doc="motor_idle of the flight controller as a fraction: motor output at zero throttle.",
        minimum=0.0,
        maximum=0.3,
    )
    min_check: int = parameter(
        1050, doc="min_check of the flight controller.", unit="us", minimum=1000, maximum=1400
    )
    lost: BetaflightLossParameters = dataclasses.field(default_factory=BetaflightLossParameters)


class BetaflightBridge(Bridge):
    """Sticks out, telemetry in, over a serial line; odometry from another node."""

    name = "betaflight_bridge"
    packages = ("nav_msgs", "serial")
    how_to_get = "pip install 'quad_mpc_ros[serial]'"
    Config = BetaflightConfig

    def __init__(self, config: BetaflightConfig, new: NewMessage) -> None:
        self.pilot_switches_mode = config.receiver == "pilot"
        super().__init__(config, new)
        self.line = line_to(config.device, config.baud)
        self.subscriptions = [self._odometry_subscription(config.odometry_topic)]
        self._telemetry = BetaflightTelemetry()
        self._protocol = MspProtocol(self._telemetry)
        self._arming_ns: int | None = None
        self._lost_ns: int | None = None
        self._flies = False
        self._flown: tuple[CommandSample, int] | None = None
        self._sent_ns: int | None = None

    def exchange(self, received: bytes, *, now_ns: int) -> bytes:
        """Receive and request telemetry, and repeat the sticks when due."""
        self._protocol.receive(received, now_ns=now_ns)
        self._warnings += self._telemetry.faults
        self._telemetry.faults.clear()
        self._receive_voltage(self._telemetry.voltage, now_ns)
        self._advance(now_ns)
        self._follow_arming(now_ns)
        requests = self._protocol.requests(now_ns=now_ns)
        if self._sent_ns is not None and abs(now_ns - self._sent_ns) < _RC_PERIOD_NS:
            return requests
        return requests + self._frame(now_ns)

    def _stack(self, now_ns: int) -> Stack:
        telemetry = self._telemetry
        if is_old(telemetry.state_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return Stack(fault=f"no telemetry within 0.5 s on {self._config.device}")
        if not telemetry.curves:
            return Stack(fault="the flight controller has not reported its rates yet")
        if FAILSAFE in telemetry.modes:
            return Stack(fault="Betaflight is in failsafe")
        if telemetry.modes & {ANGLE, HORIZON}:
            return Stack(fault="Betaflight is self-levelling (ANGLE, HORIZON): use acro mode")
        if (kind := telemetry.curves[0].kind) not in RATE_KINDS:
            return Stack(fault=f"rates type is {kind}: set ACTUAL, BETAFLIGHT or QUICK")
        taken = self._config.receiver == "bridge" or MSP_OVERRIDE in telemetry.modes
        return Stack(takes_setpoints=taken, armed=ARM in telemetry.modes)

    def _switch_back(self, now_ns: int) -> Response:
        if self._config.receiver == "pilot":
            text = "released: descending level, then stopping; switch MSP OVERRIDE off"
        else:
            text = "released: descending level, then stopping the motors and disarming"
        return Response(accepted=True, text=text)

    def _arm(self, wanted: bool) -> Response:
        if self._config.receiver == "pilot":
            return Response(accepted=False, text="the pilot arms with the transmitter")
        if not wanted:
            self._arming_ns = None
            self._flies = False
            return Response(accepted=True, text="disarming")
        blocks = [block for block in self._telemetry.blocks if block not in _TRANSIENT_BLOCKS]
        if blocks:
            return Response(accepted=False, text=f"Betaflight does not arm: {', '.join(blocks)}")
        return Response(accepted=True, text="arming")

    def arm(self, wanted: bool, *, now_ns: int) -> Response:
        """Arm or disarm, if the bridge is the receiver."""
        response = super().arm(wanted, now_ns=now_ns)
        if wanted and response.accepted:
            self._arming_ns = now_ns
        return response

    def _messages(self, command: CommandSample, now_ns: int) -> Sequence[Outgoing]:
        self._flown = command, now_ns
        return [self._frame(now_ns)]

    def _follow_arming(self, now_ns: int) -> None:
        """Give up arming after a timeout, and do not arm again after a disarming."""
        if is_old(self._telemetry.state_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return
        armed = ARM in self._telemetry.modes
        if self._flies and (not armed or not self._stack(now_ns).takes_setpoints):
            self._flies, self._arming_ns, self._lost_ns = False, None, None
        if self._arming_ns is not None and not armed and now_ns - self._arming_ns > _ARM_LIMIT_NS:
            why = ", ".join(self._telemetry.blocks) or "no reason given"
            self._refuse_arming(f"Betaflight has not armed: {why}")
            self._arming_ns = None
        self._flies = self._flies or self._handover.state is HandoverState.ENGAGED

    def _frame(self, now_ns: int) -> bytes:
        """Return the frame of the present sticks."""
        self._sent_ns = now_ns
        throttle, rates = self._wanted(now_ns)
        pulses = [_STICK_LOW] * 8 if self._config.receiver == "pilot" else [_STICK_LOW] * 16
        for channel, pulse in zip((_ROLL, _PITCH, _YAW), self._pulses(rates), strict=True):
            pulses[channel] = pulse
        pulses[_THROTTLE] = self._throttle_pulse(throttle)
        if self._config.receiver == "bridge" and self._arming_ns is not None:
            pulses[self._config.arm_channel - 1] = _STICK_HIGH
        return self._protocol.sticks(pulses)

    def _wanted(self, now_ns: int) -> tuple[float | None, _Rates]:
        """Return the throttle of the MPC's model, or None, and body rates [rad/s]."""
        still = 0.0, 0.0, 0.0
        if self._handover.state is HandoverState.ENGAGED and self._flown is not None:
            command, flown_ns = self._flown
            if abs(now_ns - flown_ns) <= round(self._config.lost.after * _SECOND):
                self._lost_ns = None
                wx, wy, wz = command.w_WB_B.tolist()
                return command.throttle, (wx, wy, wz)
        if not self._flies:
            return None, still
        if self.landed(now_ns=now_ns):
            self._arming_ns = None
            return None, still
        if self._lost_ns is None:
            self._lost_ns = now_ns
            self._warnings.append("commands lost: descending level, then the motors stop")
        if now_ns - self._lost_ns > round(self._config.lost.duration * _SECOND):
            self._arming_ns = None
            return None, still
        return self._sinking(), self._levelling(now_ns)

    def _sinking(self) -> float:
        vehicle = self._config.vehicle()
        thrust = self._config.lost.thrust * vehicle.mass * vehicle.gravity
        return float(min(max(vehicle.nearest_throttle(thrust), 0.0), 1.0))

    def _levelling(self, now_ns: int) -> _Rates:
        if is_old(self._telemetry.attitude_ns, now_ns, _TELEMETRY_PERIOD_NS):
            return 0.0, 0.0, 0.0
        gain = self._config.lost.level_gain
        return -gain * self._telemetry.roll, -gain * self._telemetry.pitch, 0.0

    def _pulses(self, rates: _Rates) -> Sequence[float]:
        """Return the pulses of roll, pitch and yaw; yaw to the right is clockwise."""
        curves, (wx, wy, wz) = self._telemetry.curves, rates
        if not curves or any(curve.kind not in RATE_KINDS for curve in curves):
            return _STICK_MIDDLE, _STICK_MIDDLE, _STICK_MIDDLE
        return [c.pulse(rate) for c, rate in zip(curves, (wx, wy, -wz), strict=True)]

    def _throttle_pulse(self, throttle: float | None) -> float:
        """Return the pulse for a throttle of the MPC's model, using the thrust map."""
        if throttle is None:
            return _STICK_LOW
        idle, low = self._config.motor_idle, float(self._config.min_check)
        share = (self.thrust.stack_throttle(throttle) - idle) / (1.0 - idle)
        return low + (_STICK_HIGH - low) * min(max(share, 0.0), 1.0)
