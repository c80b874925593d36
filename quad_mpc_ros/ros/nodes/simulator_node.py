# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node: runs the plant in real time, or in lockstep with the commands."""

from __future__ import annotations

import functools
import sys
import time
from typing import Any

from rclpy.duration import Duration
from std_srvs.srv import Trigger

from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.messages import cdr, conversions, topics
from quad_mpc_ros.messages.diagnostics import ERROR, OK
from quad_mpc_ros.messages.markers import filled_marker
from quad_mpc_ros.messages.point_cloud import written_point_cloud
from quad_mpc_ros.messages.topics import LOCKSTEP_DEPTH
from quad_mpc_ros.ros.clocks import create_steady_timer
from quad_mpc_ros.ros.compiling import log_compilation
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import new_message
from quad_mpc_ros.ros.spin import run, stop
from quad_mpc_ros.simulation.config import SimulatorConfig, compile_plant, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS, Plant, Powered
from quad_mpc_ros.simulation.sensors import OdometryStream, SentOdometry
from quad_mpc_ros.simulation.surroundings import configured_surroundings

# s: in lockstep an odometry without command is sent again after new matches, otherwise later:
# on a busy machine the command may be slow.
_RESEND_CHECK_PERIOD, _RESEND_PERIOD = 1.0, 5.0
# s: longest wait for nodes without publishers, which may be compiling.
_STARTUP_TIMEOUT = 900.0
_LOG_PERIOD = 5.0
# s: a longer wait for subscribers is logged; a signal ends it after this time.
_CONFIRMATION_PERIOD = 1.0
# Answers to odometries before the last confirmation may still be on the way. The first one waits
# for a full history, after which Fast DDS acknowledges each message at once.
_CONFIRM_AFTER, _IMU_PER_ODOMETRY = LOCKSTEP_DEPTH // 2, topics.IMU.depth // LOCKSTEP_DEPTH
_REQUIRED_TOPICS = {"mpc": topics.COMMAND, "reference": topics.REFERENCE}
# s: polling period in real time if odometries leave at irregular times
_POLL_PERIOD = 1e-3


class RealTime:
    """The plant follows the steady clock, regardless of the controller."""

    def __init__(self, node: SimulatorNode, plant: Plant) -> None:
        self._node, self._plant = node, plant

    def start(self) -> None:
        """Start the flight; stamps are from the node's clock."""
        config = self._node.config
        start_stamp_ns = int(self._node.get_clock().now().nanoseconds)
        self._started_ns = time.monotonic_ns()
        self._stream = OdometryStream(self._plant, config, start_stamp_ns=start_stamp_ns)
        regular = config.odom_delay == config.odom_jitter == 0.0
        period = 1.0 / config.odom_rate
        period = period if regular else min(period, _POLL_PERIOD)
        create_steady_timer(self._node, period, self._tick)
        self._tick()

    def receive_command(self, command: CommandSample) -> None:
        """Simulate until now with the previous command, then apply this one."""
        self._fly_to(self._elapsed_ns())
        self._plant.apply(command)

    def _tick(self) -> None:
        elapsed_ns = self._elapsed_ns()
        self._fly_to(elapsed_ns)
        if self._stream.ended(elapsed_ns):
            self._node.finish()

    def _fly_to(self, time_ns: int) -> None:
        for sent in self._stream.advance_to(time_ns):
            self._node.publish(sent)

    def _elapsed_ns(self) -> int:
        return time.monotonic_ns() - self._started_ns


class Lockstep:
    """Simulated time that waits for the command with the stamp of the last odometry."""

    def __init__(self, node: SimulatorNode, plant: Plant) -> None:
        self._node, self._plant = node, plant
        self._stream = OdometryStream(plant, node.config, start_stamp_ns=SIMULATION_START_NS)
        self._clock = node.health.publisher(topics.CLOCK)
        self._awaited: SentOdometry | None = None
        self._waiting_since = self._started = self._sent = 0.0
        self._peers: list[tuple[str, str]] = []  # matched peers at that time
        self._unconfirmed = -_CONFIRM_AFTER  # odometries, with the IMU samples beside them

    def start(self) -> None:
        """Send the first odometry."""
        self._started = time.monotonic()
        create_steady_timer(self._node, _RESEND_CHECK_PERIOD, self._resend)
        self._step()

    def receive_command(self, command: CommandSample) -> None:
        """Step if this is the awaited command; ignore repetitions."""
        if self._awaited is not None and command.stamp_ns == self._awaited.odometry.stamp_ns:
            self._plant.apply(command)
            self._step()

    def _step(self) -> None:
        self._awaited = self._stream.step()
        if self._awaited is None:
            self._node.await_subscribers()
            self._node.finish()
            return
        if self._unconfirmed >= _CONFIRM_AFTER:
            if not self._node.await_subscribers():
                return
            self._unconfirmed = 0
        self._unconfirmed += 1 + len(self._awaited.imu) // _IMU_PER_ODOMETRY
        self._waiting_since = time.monotonic()
        self._send(self._awaited)

    def _resend(self) -> None:
        """Repeat an odometry that may have been lost; fail after the timeout."""
        now = time.monotonic()
        waited = now - self._waiting_since
        if self._awaited is None or waited < _RESEND_CHECK_PERIOD:
            return
        starting = self._node.starting()
        if starting and now - self._started < _STARTUP_TIMEOUT:
            self._waiting_since = now  # the timeout starts when they can respond
            self._node.get_logger().info(
                f"waiting for {starting}, which compiles at the first start after an installation",
                throttle_duration_sec=_LOG_PERIOD,
            )
        elif waited > self._node.config.lockstep_timeout:
            self._node.fail(
                f"no command for the odometry of {self._awaited.odometry.stamp_ns * 1e-9:.3f} s "
                f"within {self._node.config.lockstep_timeout:g} s (lockstep_timeout): are mpc "
                f"and reference running, both with lockstep: true?"
            )
            return
        if self._peers != self._node.health.peers() or now - self._sent >= _RESEND_PERIOD:
            self._send(self._awaited)

    def _send(self, sent: SentOdometry) -> None:
        """Publish the simulated time of sending and the odometry.

        A repetition is the same message: noise is drawn once.
        """
        self._sent, self._peers = time.monotonic(), self._node.health.peers()
        clock = new_message(topics.CLOCK.type_name)
        conversions.fill_time(clock.clock, SIMULATION_START_NS + sent.time_ns)
        self._clock.publish(clock)
        self._node.publish(sent)


class SimulatorNode(ReportingNode[SimulatorConfig]):
    """Connects the plant to its topics, in real time or in lockstep."""

    def __init__(self) -> None:
        super().__init__("simulator", SimulatorConfig)
        self.health.lockstep = self.config.lockstep
        self._odometry = self.health.publisher(topics.ODOMETRY)
        self._odometries = self._commands = 0
        self._fault: str | None = None
        self._running = False

        with log_compilation(self):
            compile_plant(self.config)
        pacing = Lockstep if self.config.lockstep else RealTime
        plant = make_plant(self.config)
        powered = isinstance(plant, Powered) and plant.battery_voltage is not None
        self._battery = self.health.publisher(topics.BATTERY) if powered else None
        self._imu = self.health.publisher(topics.IMU) if self.config.imu_rate > 0.0 else None
        self._surroundings = configured_surroundings(
            self.config.obstacles, radius=self.config.radius
        )
        if self._surroundings is not None:
            self._surroundings.check_start(plant.odometry(0).p_WB)
        self._clouds = self._markers = None
        if self.config.obstacles.sensor == "rays":
            self._clouds = self.health.publisher(topics.OBSTACLES)
        elif self.config.obstacles.sensor == "markers":
            self._markers = self.health.publisher(topics.OBSTACLE_MARKERS)
        self._newest_ns, self._collided = -1, False
        self._pacing = pacing(self, plant)
        self.health.subscription(topics.COMMAND, self._on_command)
        self.create_service(Trigger, "~/start", self._on_start)

    def begin(self) -> None:
        """Start the flight, unless the service ``~/start`` does."""
        if self.config.autostart:
            self._start()

    def publish(self, sent: SentOdometry) -> None:
        """Publish IMU samples until an odometry, the odometry, battery voltage and perception.

        The flight ends at a collision.
        """
        if self._collided:
            return
        if self._imu is not None:
            for sample in sent.imu:
                self._imu.publish(cdr.written_imu(sample))
        self._odometry.publish(cdr.written_odometry(sent.odometry))
        self._odometries += 1
        if sent.voltage is not None and self._battery is not None:
            stamp_ns = sent.odometry.stamp_ns
            self._battery.publish(cdr.written_battery(sent.voltage, stamp_ns=stamp_ns))
        self._publish_perception(sent)

    def _publish_perception(self, sent: SentOdometry) -> None:
        """Publish the obstacle sensor's messages, and end the flight at a collision."""
        measured_ns = sent.time_ns - round(1e9 * self.config.odom_delay)
        if self._surroundings is None or measured_ns <= self._newest_ns:  # sent again
            return
        self._newest_ns = measured_ns
        perception = self._surroundings.look(sent.truth, measured_ns)
        collision = self._surroundings.collision(sent.truth, measured_ns)
        if perception.cloud is not None and self._clouds is not None:
            self._clouds.publish(written_point_cloud(perception.cloud))
        if perception.markers and self._markers is not None:
            message = new_message(topics.OBSTACLE_MARKERS.type_name)
            message.markers = [filled_marker(each, new=new_message) for each in perception.markers]
            self._markers.publish(message)
        if collision is not None:
            self._collided = True
            self.get_logger().error(f"crashed: {collision.text}")
            self.finish()

    def await_subscribers(self) -> bool:
        """Wait until all reliable subscribers, also the recorder, have every odometry.

        Shared memory has one queue of 512 messages per process, and drops further messages.
        Returns false if the flight ends.
        """
        timeout, started = self.config.lockstep_timeout, time.monotonic()
        period = Duration(seconds=min(_CONFIRMATION_PERIOD, timeout))
        while not self._odometry.wait_for_all_acked(period):
            if not self.context.ok():
                return False
            if time.monotonic() - started > timeout:
                self.fail(
                    f"a subscriber of {self._odometry.topic_name} has stopped receiving for "
                    f"{timeout:g} s (lockstep_timeout): is the recorder stopped?"
                )
                return False
            self.get_logger().info(
                f"waiting for a slow subscriber of {self._odometry.topic_name}",
                throttle_duration_sec=_LOG_PERIOD,
            )
        return True

    def starting(self) -> str:
        """Return the nodes of the vehicle that exist but do not publish yet."""
        space = self.get_namespace()
        there = {name for name, other in self.get_node_names_and_namespaces() if other == space}
        return " and ".join(
            name
            for name, topic in _REQUIRED_TOPICS.items()
            if name in there and not self.count_publishers(topic.name)
        )

    def finish(self) -> None:
        """End the flight as planned."""
        self.get_logger().info(f"flight ended: {self._commands} commands received")
        stop()

    def fail(self, fault: str) -> None:
        """End the flight with an error."""
        self._fault, self.exit_code = fault, 1
        self.get_logger().fatal(fault)
        self.health.report()
        stop()

    def _start(self) -> None:
        self._running = True
        self._pacing.start()

    def _on_start(self, _: Any, response: Any) -> Any:
        response.success = not self._running
        response.message = "already running" if self._running else "running"
        if not self._running:
            self._start()
        return response

    def _on_command(self, message: Any) -> None:
        if self._running:
            self._commands += 1
            self._pacing.receive_command(conversions.command_from_message(message))

    def report(self) -> Health:
        """Return the health: whether the flight runs, and its error."""
        text = self._fault or ("running" if self._running else "waiting for ~/start")
        return Health(
            level=ERROR if self._fault else OK,
            text=text,
            values=[("odometries", str(self._odometries)), ("commands", str(self._commands))],
        )


main = functools.partial(run, SimulatorNode)

if __name__ == "__main__":
    sys.exit(main())
