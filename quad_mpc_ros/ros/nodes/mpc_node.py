# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The MPC node: odometry and reference in, throttle and body rates out."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any

from rclpy.publisher import Publisher

from quad_mpc_ros.configuration import ConfigurationError, UserError, optional_part
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.guide import FAILED
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.margins import stability_margins
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.control.standby import Standby
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.messages import cdr, conversions, diagnostics, topics
from quad_mpc_ros.messages.corridor import written_corridor
from quad_mpc_ros.messages.diagnostics import ERROR, OK, WARN
from quad_mpc_ros.ros.clocks import SteadyTime
from quad_mpc_ros.ros.command_ownership import CommandOwnership
from quad_mpc_ros.ros.compiling import log_compilation
from quad_mpc_ros.ros.garbage_collection import GarbageCollection
from quad_mpc_ros.ros.health import Health
from quad_mpc_ros.ros.lifecycle import ManagedNode
from quad_mpc_ros.ros.messages import imu_in, new_message, odometry_in, reference_in
from quad_mpc_ros.ros.nodes.obstacle_inputs import ObstacleInputs
from quad_mpc_ros.ros.rate_loop_monitor import RateLoopMonitor
from quad_mpc_ros.ros.spin import run
from quad_mpc_ros.ros.vehicle_watch import VehicleWatch

if TYPE_CHECKING:  # imported only with a guide
    from quad_mpc_ros.extras.guidance import Guidance
    from quad_mpc_ros.extras.racing.held_gates import HeldGates

_ESTIMATE_WARNINGS = {
    "at bounds": "the estimate of thrust and wind is at its bounds",
    "reset": "the estimate of thrust and wind was reset",
}
_IMU_WARNINGS = {
    "missing": "the accelerometer is silent",
    "refused": "the accelerometer contradicts the odometry",
}
_GUIDE_WARNINGS = {FAILED: "the guide failed: obstacles are not avoided"}
# Between published plans: every plan at 50 Hz in lockstep; fewer in real time, where publishing
# takes as long as solving.
_PATH_PERIOD_NS, _LOCKSTEP_PERIOD_NS = 95_000_000, 15_000_000

# s: at most, between checks for missing odometry, because the timeout is a live parameter.
_MAX_PAUSE = 0.1
_CHECK_PERIOD = 1.0  # s: between checks for other command publishers and of the rate loop


class MpcNode(ManagedNode[MpcConfig]):
    """Connects the controller to its topics: odometry triggers it, a timer is the watchdog.

    While the node is inactive the controller receives no input, because it would assume that its
    commands are sent.
    """

    _controller: Controller
    _standby: Standby

    def __init__(self) -> None:
        super().__init__("mpc", MpcConfig)
        self._tick: Tick | None = None
        self._time = SteadyTime(self.get_clock())
        self._ownership = CommandOwnership(self)
        self._duplicates = ""
        self.start()

    def configure(self, config: MpcConfig) -> None:
        """Create the controller, publishers and subscriptions."""
        self._garbage = GarbageCollection()
        guidance = _guidance(config)
        guide = None if guidance is None else guidance.guide
        self._gates: HeldGates | None = None if guidance is None else guidance.gates
        with log_compilation(self):
            self._controller = warmed_up(config, deadline=config.deadline_seconds, guide=guide)
        if self._controller.commands_rotors:
            expected = "a controller of throttle and body rates; fly it with quad_mpc simulate"
            raise ConfigurationError("mpc.controller", config.controller, expected)
        self._rate_loop = RateLoopMonitor()
        self._rate_loop_fault: str | None = None
        self._standby = Standby(config)
        self.health.lockstep = config.lockstep
        self._engaged: bool | None = None  # commands act unless a bridge reports otherwise
        self._has_receiver = True
        self._landed: bool | None = None
        self._command = self.health.publisher(topics.COMMAND)
        self._ownership.watch(self._command, waits=not config.lockstep)
        self._stats = self.health.publisher(topics.STATS)
        self._ground = self.health.publisher(topics.GROUND_STATE)
        self._ground_message = new_message(topics.GROUND_STATE.type_name)
        self._predicted_path = self.health.publisher(topics.PREDICTED_PATH)
        self._path_period_ns = _LOCKSTEP_PERIOD_NS if config.lockstep else _PATH_PERIOD_NS
        self._path_published_ns = -self._path_period_ns

        # Raw bytes: conversion by rclpy takes longer than the control step.
        self.managed_subscription(topics.ODOMETRY, self._on_odometry, decode=odometry_in, raw=True)
        self.managed_subscription(
            topics.REFERENCE, self._on_reference, decode=reference_in, raw=True
        )
        if config.uses_accelerometer:
            self.managed_subscription(
                topics.IMU, self._on_imu, decode=imu_in, raw=True, expected=False
            )
        self.health.watch = VehicleWatch(self, config.vehicle_values())
        self.managed_subscription(
            topics.DIAGNOSTICS, self._on_diagnostics, raw=True, expected=False
        )
        self.managed_subscription(topics.ENGAGED, self._on_engaged, expected=False)
        self.managed_subscription(topics.LANDED, self._on_landed, expected=False)
        self.managed_subscription(
            topics.ODOMETRY_RESET,
            self._on_odometry_reset,
            decode=conversions.reset_from_message,
            expected=False,
        )
        self._obstacle_inputs: ObstacleInputs | None = None
        self._corridor: Publisher | None = None
        if guide is not None:
            self._corridor = self.health.publisher(topics.CORRIDOR)
        if self._gates is not None:
            self.managed_subscription(topics.GATES, self._on_gates, expected=False)
        if guidance is not None and guidance.world is not None:
            assert guidance.surroundings is not None
            self._obstacle_inputs = ObstacleInputs(
                self, guidance.world, guidance.surroundings, lockstep=config.lockstep
            )
        self.managed_timer(_CHECK_PERIOD, self._check_faults)
        if not config.lockstep:
            self.managed_timer(1.0 / config.control_rate, self._on_watchdog)

    def activation_blocker(self) -> str | None:
        """Return the missing input or the other active node that blocks activation, or None."""
        config, now_ns = self._controller.config, self._time.now_ns()
        blocker = self._standby.activation_blocker(config, now_ns=now_ns)
        if blocker is None:
            return self._ownership.activation_blocker()
        missing = self._standby.missing
        if missing not in ("odometry", "reference"):
            return blocker
        topic = topics.ODOMETRY if missing == "odometry" else topics.REFERENCE
        return f"{blocker}: {self.health.publishers_of(topic)}"

    def activate(self) -> None:
        """Start the controller with the newest odometry."""
        self._ownership.begin()
        self._finish(self._standby.begin(self._controller))

    def deactivate(self) -> None:
        """Discard the flight state; no commands until the next activation."""
        self._ownership.end()
        self._controller, self._tick = self._controller.fresh_copy(), None
        self._rate_loop = RateLoopMonitor()
        self._engage()
        self._controller.landed(self._landed)
        self._publish_ground()

    def loss_in_flight(self) -> str | None:
        """Return the consequence of stopping; None if not engaged or landed."""
        if self._engaged is False or self._controller.ground_state.is_on_ground:
            return None
        return "stopped publishing commands; the autopilot's failsafe takes over"

    def cleanup(self) -> None:
        """Release the controller."""
        self._ownership.watch(None)
        if self._obstacle_inputs is not None:
            self._obstacle_inputs.close()
        del self._controller, self._standby

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply live parameters between two control steps."""
        self._controller.reconfigure(config)
        self._standby.reconfigure(config)

    def _on_odometry(self, odometry: OdometrySample) -> None:
        now_ns = self._time.now_ns()
        self._standby.receive_odometry(odometry, now_ns=now_ns)
        self._ownership.note_message()
        if self._obstacle_inputs is not None:
            self._obstacle_inputs.receive_odometry(odometry)
        if self.active:
            self._finish(self._controller.receive_odometry(odometry, now_ns=now_ns))
        else:
            self.activate_when_ready()

    def _on_imu(self, sample: ImuSample) -> None:
        """Receive an accelerometer sample; ignored while inactive."""
        if not self.active:
            return
        tick = self._controller.receive_imu(sample)
        if tick is not None:
            self._finish(tick)
        else:
            self._log_warnings()

    def _on_reference(self, window: ReferenceWindow) -> None:
        now_ns = self._time.now_ns()
        self._standby.receive_reference(window, now_ns=now_ns)
        if self.active:
            self._finish(self._controller.receive_reference(window, now_ns=now_ns))
        else:
            self.activate_when_ready()

    def _on_engaged(self, message: Any) -> None:
        """Receive whether the vehicle executes commands, and log changes."""
        engaged = bool(message.data)
        if engaged is not self._engaged:
            self._engaged = engaged
            self._engage()
            self.get_logger().info(
                "commands act" if engaged else "commands are not executed: estimation is paused"
            )

    def _engage(self) -> None:
        """Let the controller know whether the vehicle executes commands."""
        self._controller.engage(self._engaged is not False and self._has_receiver)

    def _note_receiver(self) -> None:
        """Note whether anything subscribes to the command: until then, nothing executes it."""
        if self._controller.config.lockstep:  # the simulator waits for each command
            return
        if (self._command.get_subscription_count() > 0) != self._has_receiver:
            self._has_receiver = not self._has_receiver
            self._engage()

    def _on_landed(self, message: Any) -> None:
        self._landed = bool(message.data)
        self._controller.landed(self._landed)

    def _on_diagnostics(self, data: bytes) -> None:
        """Compare vehicles, and yield to an MPC that is already active."""
        if self.health.watch is not None:
            self.health.watch.receive(data)
        reason = self._ownership.receive(data)
        if reason and self.active:
            self.stay_inactive(reason)
        elif not self.active and self._autostarting and self._ownership.is_taken():
            blocker = self._ownership.activation_blocker()
            self.stay_inactive(f"inactive: {blocker}, then activate this node")

    def _on_odometry_reset(self, reset: EstimateReset) -> None:
        self._standby.reset_estimate(reset)
        self._controller.reset_estimate(reset)

    def _on_gates(self, message: Any) -> None:
        """Receive the current poses of the gates."""
        frame_id = self._controller.config.odometry.frame_id
        if self._gates is not None:
            try:
                poses = conversions.poses_from_message(message, frame_id=frame_id)
                self._gates.move(*poses)
            except UserError as error:
                self.warnings.warn(str(error))

    def _on_watchdog(self) -> float:
        """React to missing odometry; return the time until the next check [s]."""
        now_ns = self._time.now_ns()
        if self.active:
            self._finish(self._controller.watch(now_ns=now_ns))
        period = 1.0 / self._controller.config.control_rate
        if self._time.is_simulated:  # simulated time may run faster than the timer
            return period
        pause = min(self._controller.seconds_until_odometry_lost(now_ns=now_ns), _MAX_PAUSE)
        return max(pause, period)

    def _finish(self, tick: Tick | None) -> None:
        """Publish the command, then everything else.

        Only the ground state is published earlier, to arrive before the next odometry.
        """
        if tick is not None:
            self._publish_ground()
            if tick.command is not None:
                self._command.publish(cdr.written_command(tick.command))
                self._note_receiver()
            self._log_change(tick)
            self._note_errors(tick)
            self._publish_insight(tick)
            self._tick = tick
            self._garbage.after_tick()
        self._log_warnings()
        if self._obstacle_inputs is not None:
            for refusal in self._obstacle_inputs.take_warnings():
                self.warnings.warn(refusal)

    def _note_errors(self, tick: Tick) -> None:
        """Let the node end with exit code 1 after an error of a controller other than the MPC."""
        failed = tick.counts["solver_failures"] + tick.counts["deadline_misses"] > 0
        if failed and self._controller.config.controller != MPC:
            self.exit_code = 1

    def _check_faults(self) -> None:
        """Detect and log other command publishers and a ringing or slow rate loop."""
        duplicates = self._ownership.fault() if self.active else ""
        if duplicates and duplicates != self._duplicates:
            self.get_logger().warning(f"{duplicates}; this node keeps commanding")
        self._duplicates = duplicates
        # Once a second: the figures of a tick are computed when they are first read.
        fault = None if self._tick is None else self._rate_loop.check(self._tick.stats)
        if fault is not None:
            self.warnings.warn(fault)
        self._rate_loop_fault = fault

    def _log_warnings(self) -> None:
        for warning in self._controller.take_warnings():
            self.warnings.warn(warning)

    def _publish_ground(self) -> None:
        """Publish changes of the ground state while ROS is running."""
        state = self._controller.ground_state.value
        if state != self._ground_message.data and self.context.ok():
            self._ground_message.data = state
            self._ground.publish(self._ground_message)

    def _publish_insight(self, tick: Tick) -> None:
        if self._stats.get_subscription_count() > 0:
            self._stats.publish(diagnostics.written_stats(tick.stats))
        if tick.plan is not None and self._path_is_due(tick.plan.stamp_ns):
            frame_id = self._controller.config.odometry.frame_id
            self._predicted_path.publish(conversions.written_plan(tick.plan, frame_id=frame_id))
            if self._corridor is not None and tick.guided is not None:
                stamp_ns = tick.plan.stamp_ns
                data = written_corridor(tick.guided.corridor, stamp_ns=stamp_ns, frame_id=frame_id)
                self._corridor.publish(data)

    def _path_is_due(self, stamp_ns: int) -> bool:
        """Return whether the path has a subscriber and its period has passed."""
        if abs(stamp_ns - self._path_published_ns) < self._path_period_ns:
            return False
        if self._predicted_path.get_subscription_count() == 0:
            return False
        self._path_published_ns = stamp_ns
        return True

    def _log_change(self, tick: Tick) -> None:
        """Log changes of the active source."""
        before = self._tick.decision.source if self._tick is not None else Source.WAITING
        now = tick.decision.source
        if now is before:
            return
        if now is Source.MPC:
            name = self._controller.config.controller
            self.get_logger().info(f"{'the MPC' if name == MPC else name} flies")
            return
        text = f"{now.name.lower()} takes over: {tick.decision.reason}"
        # Two statements: rclpy raises if one statement logs with two severities.
        if now in (Source.BLIND, Source.SILENT):
            self.get_logger().error(text)
        else:
            self.get_logger().warning(text)

    def report(self) -> Health:
        """Return the health: the active source, warnings and duplicate publishers."""
        health = self._health_of_flight()
        if not self._duplicates:
            return health
        text = f"{self._duplicates}; {health.text}"
        return Health(level=max(health.level, WARN), text=text, values=health.values)

    def values(self) -> list[tuple[str, str]]:
        """Return the values of command ownership, for other MPCs."""
        return self._ownership.values()

    def _health_of_flight(self) -> Health:
        tick = self._tick
        if tick is None:
            return Health(level=WARN, text="waiting for the first plan")
        source = tick.decision.source
        level = {Source.MPC: OK, Source.PLAN: WARN, Source.WAITING: WARN}.get(source, ERROR)
        engaged = "unknown" if self._engaged is None else str(self._engaged).lower()
        warnings = [
            _ESTIMATE_WARNINGS.get(tick.stats.estimate),
            _IMU_WARNINGS.get(tick.stats.accelerometer),
            self._rate_loop_fault,
            None if self._has_receiver else f"nothing subscribes to {self._command.topic_name}",
            _GUIDE_WARNINGS.get(tick.stats.avoidance),
        ]
        texts = [tick.decision.reason or "flying", *filter(None, warnings)]
        level, text = level if len(texts) == 1 else max(level, WARN), ", ".join(texts)
        obstacle_values: list[tuple[str, str]] = []
        if self._obstacle_inputs is not None:
            if fault := self._obstacle_inputs.fault(tick.stats.stamp_ns):
                level, text = max(level, WARN), f"{text}; {fault}"
            obstacle_values = self._obstacle_inputs.values(tick.stats.stamp_ns)
        values = [*tick.stats.items(), *obstacle_values, ("engaged", engaged)]
        if self._controller.config.controller == MPC:
            scale = round(tick.stats.rate_weight_scale, 2)  # few values: each takes a millisecond
            delay, gain = stability_margins(self._controller.config, scale)
            values += [("delay_margin_ms", f"{1e3 * delay:.0f}"), ("gain_margin", f"{gain:.1f}")]
        return Health(level=level, text=text, values=values)


def _guidance(config: MpcConfig) -> Guidance | None:
    """Return the configured guidance, or None."""
    if not config.guided_by:
        return None
    guidance: Guidance = optional_part("guidance", needed_by=config.guided_by)(config)
    return guidance


main = functools.partial(run, MpcNode)

if __name__ == "__main__":
    sys.exit(main())
