# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the MAVLink bridge: requests to the autopilot, engagement and setpoints.

Engaged or not, the bridge sends a heartbeat as an onboard computer and requests the vehicle's
time, parameters and messages. Setpoints are sent only in response to commands.

``docs/measurements/flight_stacks.md`` has the measured ages of the autopilot's messages.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.ros.bridges.bridge import (
    FORCED,
    Bridge,
    Outgoing,
    Response,
    command_result,
)
from quad_mpc_ros.ros.bridges.handover import HandoverState, LatestStatus, Stack, is_old
from quad_mpc_ros.ros.bridges.line import line_to
from quad_mpc_ros.ros.bridges.mavlink import codec
from quad_mpc_ros.ros.bridges.mavlink.autopilots import AUTOPILOTS, Autopilot, cosine_of_tilt
from quad_mpc_ros.ros.bridges.mavlink.codec import Codec
from quad_mpc_ros.ros.bridges.mavlink.config import MavlinkConfig
from quad_mpc_ros.ros.bridges.mavlink.link import (
    AutopilotParameters,
    OtherSetpointSources,
    VehicleClock,
)

_SECOND = 1_000_000_000
_LINE_PERIOD = 0.002  # s: messages wait for half of it on average
_HEARTBEAT_NS, _TIME_NS = _SECOND, _SECOND // 10
_STATE_NS = _SECOND // 2  # without state for this time it is requested again
# PX4 has no interval for HEARTBEAT: request each one. CURRENT_MODE comes with each change.
_REQUEST_NS = _SECOND // 10
_PARAMETERS_NS = 300_000_000
_HEARTBEAT_TIMEOUT, _LAND_TIMEOUT, _ODOMETRY_TIMEOUT = 1.5, 2.5, 1.0  # s
_MESSAGE_RATES = {codec.EXTENDED_SYS_STATE: 5.0, codec.SYS_STATUS: 2.0}  # Hz
_MESSAGE_RATES |= {codec.ATTITUDE_TARGET: 20.0, codec.CURRENT_MODE: 50.0}
_ARMED = 128  # of base_mode
_FAILING = (5, 6, 8)  # MAV_STATE: critical, emergency, terminating
_ON_GROUND, _IN_AIR = 1, 2
_ACCEPTED, _IN_PROGRESS = 0, 5
_WARNING_SEVERITY = 4  # MAV_SEVERITY: less severe texts are not logged
_TEXT_CHUNK_LENGTH, _MAX_WARNING_LENGTH = 50, 300  # characters
_COMMAND_NAMES = {codec.DO_SET_MODE: "the mode", codec.COMPONENT_ARM_DISARM: "arming"}
_SETPOINTS = (
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
)


class MavlinkBridge(Bridge):
    """Bridge with attitude targets (body rates) out; state, modes and parameters in."""

    name = "mavlink_bridge"
    packages = ("pymavlink", "serial")
    how_to_get = "pip install 'quad_mpc_ros[mavlink]'"
    Config = MavlinkConfig

    def __init__(self, config: MavlinkConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self.line = line_to(config.device, config.baud)
        self.line.period = _LINE_PERIOD
        if config.odometry_topic:
            self.subscriptions = [self._odometry_subscription(config.odometry_topic)]
        self._codec: Codec | None = None
        self._autopilot: Autopilot | None = None
        self._settings = AutopilotParameters(())
        self._component = codec.AUTOPILOT_COMPONENT
        self._time, self._others = VehicleClock(), OtherSetpointSources()
        self._heartbeat = LatestStatus(timeout=_HEARTBEAT_TIMEOUT)
        self._mode = self._intended_mode = 0
        self._land = LatestStatus(timeout=_LAND_TIMEOUT)
        self._attitude = LatestStatus(timeout=_ODOMETRY_TIMEOUT)
        self._own_odometry = LatestStatus(timeout=_ODOMETRY_TIMEOUT)
        self._resets: int | None = None
        self._system, self._was_failing = config.target_system, False
        self._text, self._flown = "", False
        self._landed_since_ns: int | None = None
        self._done_ns: dict[str, int] = {}
        self._handlers: dict[str, Callable[[Any, int], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "CURRENT_MODE": self._on_current_mode,
            "ODOMETRY": self._on_odometry,
            "ATTITUDE_QUATERNION": self._attitude.receive,
            "LOCAL_POSITION_NED": self._on_position,
            "EXTENDED_SYS_STATE": self._land.receive,
            "SYS_STATUS": self._on_sys_status,
            "PARAM_VALUE": self._on_parameter,
            "ATTITUDE_TARGET": self._on_target,
            "TIMESYNC": self._on_time,
            "COMMAND_ACK": self._on_ack,
            "STATUSTEXT": self._on_text,
        }

    def exchange(self, received: bytes, *, now_ns: int) -> bytes:
        """Receive the vehicle's messages and return the due requests."""
        if self._codec is None:
            self._codec = Codec(system=self._system or 1)
        for message in self._codec.read(received):
            self._receive(message, now_ns)
        self._advance(now_ns)
        due = self._due(now_ns) + self._due_landed(now_ns)
        return b"".join(map(self._codec.packed, due))

    def landed(self, *, now_ns: int) -> bool | None:
        """Return the state of the land detector, or else a state derived from arming."""
        land = self._land.value(now_ns=now_ns)
        if land is None or land.landed_state == 0:
            return super().landed(now_ns=now_ns)
        return bool(land.landed_state == _ON_GROUND)

    def _stack(self, now_ns: int) -> Stack:
        heartbeat, autopilot = self._heartbeat.value(now_ns=now_ns), self._autopilot
        if heartbeat is None or autopilot is None:
            fault = (
                f"no heartbeat of PX4 or ArduPilot within {_HEARTBEAT_TIMEOUT:g} s on "
                f"{self._config.device}"
            )
            return Stack(fault=fault)
        fault = f"{autopilot.name} has not sent its parameters yet"
        if self._settings.are_complete:
            fault = autopilot.fault(self._settings.values) or self._others.fault(now_ns=now_ns)
        in_failsafe = heartbeat.system_status in _FAILING or autopilot.takes_setpoints(
            self._intended_mode
        )
        cause = "in a failsafe" if in_failsafe else "for a pilot or a ground station"
        return Stack(
            fault=fault,
            takes_setpoints=autopilot.takes_setpoints(self._mode),
            armed=bool(heartbeat.base_mode & _ARMED),
            exit_reason=f"{autopilot.name} switched to {autopilot.mode_name(self._mode)} {cause}",
        )

    def _engage_blocker(self, now_ns: int) -> str:
        heartbeat = self._heartbeat.value(now_ns=now_ns)
        if heartbeat is not None and heartbeat.system_status in _FAILING:
            return "the autopilot reports a failsafe"
        return super()._engage_blocker(now_ns)

    def _arm(self, wanted: bool) -> Response:
        if wanted:
            return self._requested("arming", codec.COMPONENT_ARM_DISARM, 1.0)
        return self._requested("disarming", codec.COMPONENT_ARM_DISARM, 0.0, FORCED)

    def _switch(self) -> list[Outgoing]:
        if self._autopilot is None:
            return []
        mode = self._autopilot.setpoint_mode
        return [self._packed(self._command(codec.DO_SET_MODE, *mode))]

    def _switch_back(self, now_ns: int) -> Response:
        if self._autopilot is None:
            return Response(accepted=True, text="released")
        name, mode = self._autopilot.release_mode
        return self._requested(f"mode {name}", codec.DO_SET_MODE, *mode)

    def _messages(self, command: CommandSample, now_ns: int) -> list[Outgoing]:
        assert self._autopilot is not None
        throttle = self._autopilot.throttle(
            self.thrust.stack_throttle(command.throttle),
            self._settings.values,
            up=cosine_of_tilt(self._newest, now_ns=now_ns),
        )
        target = codec.attitude_target(
            command,
            throttle=throttle,
            now_ns=now_ns,
            system=self._system,
            component=self._component,
        )
        self._others.note_setpoint(self._autopilot.echo(target), now_ns=now_ns)
        return [self._packed(target)]

    def _receive(self, message: Any, now_ns: int) -> None:
        kind, system = message.get_type(), message.get_srcSystem()
        if kind in _SETPOINTS and message.target_system == self._system:
            sender = f"{kind} of system {system}, component {message.get_srcComponent()}"
            self._others.note_sender(sender, now_ns=now_ns)
            return
        if kind == "HEARTBEAT" or (
            system == self._system and message.get_srcComponent() == self._component
        ):
            take = self._handlers.get(kind)
            if take is not None:
                take(message, now_ns)

    def _on_heartbeat(self, message: Any, now_ns: int) -> None:
        kind = AUTOPILOTS.get(int(message.autopilot))
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if kind is None or self._system not in (0, system):
            return
        if self._autopilot is None:
            self._system, self._component = system, component
            self._codec = Codec(system=system)
        if component != self._component:
            return
        if not isinstance(self._autopilot, kind):
            self._autopilot = kind(self._config)
            self._settings = AutopilotParameters(self._autopilot.settings)
            self.streams, self.warm_up = self._autopilot.streams, self._autopilot.warm_up
        self._heartbeat.receive(message, now_ns)
        self._set_mode(int(message.custom_mode), now_ns)
        failing = message.system_status in _FAILING
        if failing and not self._was_failing:
            self._warnings.append(f"{self._autopilot.name} reports a failsafe")
        self._was_failing = failing

    def _on_current_mode(self, message: Any, now_ns: int) -> None:
        """Receive a changed mode or arming; request a heartbeat, which has both."""
        self._intended_mode = int(message.intended_custom_mode)
        self._set_mode(int(message.custom_mode), now_ns)
        self._done_ns.pop("request", None)

    def _set_mode(self, mode: int, now_ns: int) -> None:
        assert self._autopilot is not None
        self._mode = mode
        self._others.resolve(takes_setpoints=self._autopilot.takes_setpoints(mode), now_ns=now_ns)

    def _on_odometry(self, message: Any, now_ns: int) -> None:
        if self._config.odometry_topic:
            return
        self._own_odometry.receive(message, now_ns)
        before, self._resets = self._resets, int(message.reset_counter)
        cause = None
        if before not in (None, self._resets):
            cause = f"reset_counter {before} to {self._resets}"
        odometry = self._converted("ODOMETRY", lambda: codec.odometry_from_odometry(message))
        self._take(odometry, now_ns, cause)

    def _on_position(self, message: Any, now_ns: int) -> None:
        attitude = self._attitude.value(now_ns=now_ns)
        known = self._own_odometry.value(now_ns=now_ns) is not None
        if self._config.odometry_topic or attitude is None or known:
            return
        odometry = self._converted(
            "LOCAL_POSITION_NED",
            lambda: codec.odometry_from_position_and_attitude(message, attitude),
        )
        self._take(odometry, now_ns, None)

    def _take(self, odometry: OdometrySample | None, now_ns: int, cause: str | None) -> None:
        """Publish an odometry, stamped with the node's clock."""
        if odometry is not None:
            stamp_ns = odometry.stamp_ns + self._time.offset_ns
            odometry = dataclasses.replace(odometry, stamp_ns=stamp_ns)
        if self._passed_on(odometry, now_ns=now_ns, cause=cause) is not None:
            self._done_ns["state"] = now_ns

    def _on_sys_status(self, message: Any, now_ns: int) -> None:
        self._receive_voltage(1e-3 * int(message.voltage_battery), now_ns)

    def _on_parameter(self, message: Any, now_ns: int) -> None:
        autopilot = self._autopilot
        if autopilot is None:
            return
        name, value = codec.parameter_of(message, by_bytes=autopilot.by_bytes)
        changed = self._settings.receive(name, value)
        warning = autopilot.hold_warning(self._settings.values)
        if changed and name == autopilot.hold_setting and warning is not None:
            self._warnings.append(warning)

    def _on_target(self, message: Any, now_ns: int) -> None:
        land = self._land.value(now_ns=now_ns)
        flies = land is not None and land.landed_state == _IN_AIR
        if self._autopilot is not None and flies and self._handover.state is HandoverState.ENGAGED:
            self._others.receive_target(self._autopilot.echo(message), now_ns=now_ns)
            if self._others.suspected:
                self._done_ns.pop("request", None)

    def _on_time(self, message: Any, now_ns: int) -> None:
        if message.tc1 > 0:
            self._time.receive(
                sent_ns=int(message.ts1), vehicle_ns=int(message.tc1), now_ns=now_ns
            )

    def _on_ack(self, message: Any, now_ns: int) -> None:
        number = int(message.command)
        what = _COMMAND_NAMES.get(number)
        if what is None or message.result in (_ACCEPTED, _IN_PROGRESS):
            return
        result = command_result(int(message.result))
        if number == codec.COMPONENT_ARM_DISARM and self._arming is not None:
            what = "arming" if self._arming[0] else "disarming"
            self._refuse_arming(f"the autopilot refuses {what}: {result}")
        else:
            self._warnings.append(f"the autopilot refuses {what}: {result}")

    def _on_text(self, message: Any, now_ns: int) -> None:
        """Log a text; a long text comes in chunks with an id other than 0."""
        if message.chunk_seq == 0:
            self._text = ""
        text = codec.text_of(message.text)
        self._text += text
        goes_on = message.id != 0 and len(text) == _TEXT_CHUNK_LENGTH
        if message.severity <= _WARNING_SEVERITY and not goes_on:
            whole = self._text[:_MAX_WARNING_LENGTH].strip()  # PX4's event texts end in a tab
            self._warnings.append(f"the autopilot reports: {whole}")
            if self._arming is not None and self.arming_outcome(now_ns=now_ns) is None:
                self._reasons.append(whole)

    def _due(self, now_ns: int) -> list[Any]:
        """Return the messages that are due, engaged or not."""
        due = []
        if self._is_due("heartbeat", _HEARTBEAT_NS, now_ns):
            due.append(codec.heartbeat())
            autopilot = self._autopilot
            if autopilot is not None and autopilot.needs_ground_station(self._settings.values):
                due.append(codec.heartbeat(ground_station=True))
        if self._autopilot is None:
            return due
        if self._is_due("request", _REQUEST_NS, now_ns):
            due.append(self._command(codec.REQUEST_MESSAGE, float(codec.HEARTBEAT)))
        if self._is_due("time", _TIME_NS, now_ns):
            self._time.note_request(now_ns=now_ns)
            due.append(codec.timesync(sent_ns=now_ns))
        if self._is_due("parameters", _PARAMETERS_NS, now_ns):
            request = codec.dialect().MAVLink_param_request_read_message
            due += [
                request(self._system, self._component, name.encode(), -1)
                for name in self._settings.take_due()
            ]
        # First in any case: unrequested messages have a rate chosen by the autopilot.
        lacks = "rates" not in self._done_ns or self._lacks_messages(now_ns)
        if lacks and self._is_due("rates", _SECOND, now_ns):
            rates = _MESSAGE_RATES
            if not self._config.odometry_topic:
                rates = rates | dict.fromkeys(self._autopilot.state, self._config.state_rate)
            due += [
                self._command(codec.SET_MESSAGE_INTERVAL, float(number), 1e6 / rate)
                for number, rate in rates.items()
            ]
        return due

    def _due_landed(self, now_ns: int) -> list[Any]:
        """Return the request for the landing mode after a landing, if the autopilot needs it."""
        if self._handover.state is not HandoverState.ENGAGED or not self._mpc_ground.is_on_ground:
            self._flown = self._handover.state is HandoverState.ENGAGED and (
                self._flown or self._mpc_ground.is_flying
            )
            self._landed_since_ns = None
            return []
        wait, autopilot = self._config.land_mode_after, self._autopilot
        if autopilot is None or autopilot.landed_mode is None or not self._flown or wait == 0.0:
            return []
        if self._landed_since_ns is None:
            self._landed_since_ns = now_ns
        if now_ns - self._landed_since_ns < round(wait * _SECOND):
            return []
        self._handover.release("released after landing, to mode LAND, which disarms")
        return [self._command(codec.DO_SET_MODE, *autopilot.landed_mode)]

    def _is_due(self, what: str, period_ns: int, now_ns: int) -> bool:
        """Return whether a periodic action is due, and record it as done."""
        before_ns = self._done_ns.get(what)
        if before_ns is not None and abs(now_ns - before_ns) < period_ns:
            return False
        self._done_ns[what] = now_ns
        return True

    def _lacks_messages(self, now_ns: int) -> bool:
        """Return whether the land detector or the required state is missing."""
        if self._land.value(now_ns=now_ns) is None:
            return True
        late = is_old(self._done_ns.get("state"), now_ns, _STATE_NS)
        return late and not self._config.odometry_topic

    def _command(self, command: int, *parameters: float) -> Any:
        return codec.command_long(
            command, *parameters, system=self._system, component=self._component
        )

    def _packed(self, message: Any) -> bytes:
        assert self._codec is not None
        return self._codec.packed(message)

    def _requested(self, what: str, command: int, *parameters: float) -> Response:
        """Return the response with a command for the autopilot."""
        if self._autopilot is None:
            return Response(accepted=False, text="no heartbeat of PX4 or ArduPilot yet")
        message = self._packed(self._command(command, *parameters))
        return Response(accepted=True, text=f"asked for {what}", messages=[message])
