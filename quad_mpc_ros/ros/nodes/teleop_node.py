"""The teleop node: keyboard and joystick to velocities, steps and requests to the reference."""

from __future__ import annotations

import functools
import math
import sys
import time
from typing import Any

from std_srvs.srv import Trigger

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.diagnostics import OK, WARN
from quad_mpc_ros.messages.topics import DIAGNOSTICS, GOAL_POSE, JOYSTICK, REFERENCE, VELOCITY
from quad_mpc_ros.references.flatness import yaw_of
from quad_mpc_ros.ros.clocks import create_steady_timer
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import decoded, new_message, reference_in
from quad_mpc_ros.ros.spin import EXIT_BAD_INPUT, run, stop
from quad_mpc_ros.ros.teleop import terminal
from quad_mpc_ros.ros.teleop.config import TeleopConfig
from quad_mpc_ros.ros.teleop.joystick import Joystick
from quad_mpc_ros.ros.teleop.keyboard import HELP, MOVES, REQUEST_KEYS, Keyboard, keys_in
from quad_mpc_ros.ros.teleop.motion import REQUESTS, STILL, Latch, Motion, Steps, stepped
from quad_mpc_ros.ros.teleop.terminal import Terminal

_BODY_FRAME = "base_link"
_PATIENCE = 3.0  # s: until a joystick that is there must have been discovered
_STEP_PERIOD, _KEY_STEP_PERIOD = 0.5, 0.3  # s
_FASTER = {"+": 1.25, "=": 1.25, "-": 0.8}
_SLOWEST, _FASTEST = 0.1, 10.0
_STOPS = 10  # messages that say stop: one may be lost
_NO_TERMINAL = "no terminal to read keys from: start it with ros2 run in a terminal"
# Of the reference's requests: what comes by topics and is not answered otherwise.
_TOLD = ("velocity", "goal", "touchdown", "handover", "odometry")


class TeleopNode(ReportingNode[TeleopConfig]):
    """Reads keys and sticks at a steady rate.

    While something is held it publishes velocities, and when it is let go a few that say stop;
    otherwise nothing, so that others may command. What the reference node answers is logged.
    """

    def __init__(self) -> None:
        super().__init__("teleop", TeleopConfig)
        config = self.config
        self._started = time.monotonic()
        self._position_mode = config.mode == "position"
        self._factor = 1.0
        self._stops_left = 0
        self._goal: tuple[Array, float] | None = None
        self._frame_id = ""
        self._reference: bytes | None = None
        self._told: dict[str, str] = {}
        self._lost = False
        self._keyboard = Keyboard(delay=config.key_delay, timeout=config.key_timeout)
        self._joystick = Joystick(config.joystick)
        self._latch = Latch()
        self._steps, self._key_steps = Steps(_STEP_PERIOD), Steps(_KEY_STEP_PERIOD)

        self._velocity = self.health.publisher(VELOCITY)
        self._goal_pose = self.health.publisher(GOAL_POSE)
        self.health.subscription(REFERENCE, self._on_reference, raw=True)
        self.health.subscription(DIAGNOSTICS, self._on_diagnostics, raw=True, expected=False)
        if config.input != "keyboard":
            self.health.subscription(JOYSTICK, self._on_joystick, expected=False)
        self._requests = {
            name: self.create_client(Trigger, f"reference/{name}") for name in REQUESTS
        }
        create_steady_timer(self, 1.0 / config.rate, self._on_beat)
        self._terminal = self._opened_terminal()  # last: what failed before has not changed it

    def destroy_node(self) -> None:
        """Restore the terminal, then end the node."""
        if self._terminal is not None:
            self._terminal.close()
        super().destroy_node()

    def _opened_terminal(self) -> Terminal | None:
        if self.config.input == "joystick":
            return None
        if not terminal.is_there():
            if self.config.input == "keyboard":
                raise UserError(_NO_TERMINAL)
            return None
        print(HELP, flush=True)
        return Terminal()

    def _on_beat(self) -> None:
        now = time.monotonic()
        for key in keys_in(self._terminal.read()) if self._terminal is not None else ():
            self._take_key(key, now)
        self._watch_inputs(now)
        motion = self._joystick.motion(now=now)
        if motion == STILL:
            motion = self._keyboard.motion(now=now)
        motion = self._latch.passed(motion)
        if self._position_mode:
            self._send_step(self._steps.step(motion, now=now))
        else:
            self._send_velocity(motion)

    def _take_key(self, key: str, now: float) -> None:
        if key in MOVES and self._position_mode:  # one that is pressed briefly is one step
            self._send_step(self._key_steps.step(MOVES[key], now=now))
        elif key in MOVES:
            self._keyboard.press(key, now=now)
        elif key in REQUEST_KEYS:
            self._request(REQUEST_KEYS[key])
        elif key in _FASTER:
            self._factor = min(max(self._factor * _FASTER[key], _SLOWEST), _FASTEST)
            speed, step = (self._factor * each for each in (self.config.speed, self.config.step))
            self.get_logger().info(f"{speed:.2f} m/s, steps of {step:.2f} m")
        elif key == "m":
            self._position_mode, self._goal = not self._position_mode, None
            self._latch.close()
            self.get_logger().info("steps" if self._position_mode else "velocity")
        elif key == "x":
            stop()

    def _watch_inputs(self, now: float) -> None:
        """Say once that a joystick is lost; end when there never was anything to fly with."""
        lost = self._joystick.was_there and not self._joystick.is_connected(now=now)
        if lost and not self._lost:
            self.get_logger().warning(
                f"no message of the joystick for {self.config.joystick.timeout:g} s: the vehicle "
                "brakes and holds"
            )
        self._lost = lost
        reads = self._terminal is not None and self._terminal.is_open
        if self.config.input == "joystick" or reads or now - self._started < _PATIENCE:
            return
        if self.config.input == "keyboard" or not self.count_publishers(JOYSTICK.name):
            self.get_logger().error(
                f"{_NO_TERMINAL}; and nobody publishes {JOYSTICK.name}: start ros2 run joy "
                "game_controller_node, or set input to joystick to wait for it"
            )
            self.exit_code = EXIT_BAD_INPUT
            stop()

    def _send_velocity(self, motion: Motion) -> None:
        """Publish a velocity while there is one, and then that it is over."""
        if motion != STILL:
            self._stops_left, self._goal = _STOPS, None
        elif self._stops_left == 0:
            return
        else:
            self._stops_left -= 1
        config, factor = self.config, self._factor
        message = new_message(VELOCITY.type_name)
        conversions.fill_header(
            message.header, int(self.get_clock().now().nanoseconds), _BODY_FRAME
        )
        level, climb = factor * config.speed, factor * config.climb_speed
        conversions.fill_vector(
            message.twist.linear, (level * motion.forward, level * motion.left, climb * motion.up)
        )
        message.twist.angular.z = config.yaw_rate * motion.yaw
        self._velocity.publish(message)

    def _send_step(self, step: Motion | None) -> None:
        """Ask for the place a step further than where the reference leads."""
        if step is None:
            return
        if self._goal is None:
            if self._reference is None:
                self.get_logger().warning("no step: no reference received yet")
                return
            window = reference_in(self._reference)
            R_WB = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw[-1])
            self._goal = window.p_WB[-1], yaw_of(R_WB)
            self._frame_id = window.frame_id
        length = self._factor * self.config.step
        self._goal = stepped(*self._goal, step, length=length, turn=self.config.yaw_step)
        p_WB, yaw = self._goal
        message = new_message(GOAL_POSE.type_name)
        conversions.fill_header(
            message.header, int(self.get_clock().now().nanoseconds), self._frame_id
        )
        conversions.fill_vector(message.pose.position, p_WB.tolist())
        half = 0.5 * yaw
        conversions.fill_quaternion(
            message.pose.orientation, (0.0, 0.0, math.sin(half), math.cos(half))
        )
        self._goal_pose.publish(message)

    def _request(self, name: str) -> None:
        """Ask the reference node; whatever is still pushed does not count until let go."""
        self._latch.close()
        self._keyboard.release()
        self._goal = None
        client = self._requests[name]
        if not client.service_is_ready():
            self.get_logger().warning(
                f"{name}: no service {client.srv_name}: start the reference node, in this "
                "namespace"
            )
            return
        answer = client.call_async(Trigger.Request())
        answer.add_done_callback(functools.partial(self._on_answer, name))

    def _on_answer(self, name: str, answer: Any) -> None:
        response = answer.result()
        if response.success:
            self.get_logger().info(f"{name}: {response.message}")
        else:
            self.get_logger().warning(f"{name} refused: {response.message}")

    def _on_joystick(self, message: Any) -> None:
        requests = self._joystick.receive(message.axes, message.buttons, now=time.monotonic())
        if self._joystick.missing:
            self.get_logger().warning(
                f"the joystick has {len(message.axes)} axes and {len(message.buttons)} buttons, "
                f"not {self._joystick.missing}: set joystick.* by what ros2 topic echo "
                f"{JOYSTICK.name} shows",
                throttle_duration_sec=10.0,
            )
        for name in requests:
            self._request(name)

    def _on_reference(self, data: bytes) -> None:
        self._reference = data

    def _on_diagnostics(self, data: bytes) -> None:
        """Show what the reference node says of velocities and goals, and what it flies."""
        if b"reference\0" not in data:
            return
        ours = f"{self.get_namespace().rstrip('/')}/reference"
        for status in decoded(DIAGNOSTICS, data).status:
            if status.name != ours:
                continue
            values = {pair.key: pair.value for pair in status.values}
            told = {name: values.get(name, "") for name in ("request", "mode")}
            before, self._told = self._told, told
            if before and told["request"] != before["request"]:
                self._show_verdict(told["request"])
            if told["mode"] != before.get("mode"):
                self.get_logger().info(f"the reference is in {told['mode'] or 'no mode yet'}")

    def _show_verdict(self, verdict: str) -> None:
        """Log what became of something asked by a topic."""
        name, _, result = verdict.partition(" ")
        if name not in _TOLD:
            return
        if result.startswith("refused"):
            self._goal = None  # the next step begins where the reference leads
            self.get_logger().warning(verdict)
        elif name != "goal":
            self.get_logger().info(verdict)

    def report(self) -> Health:
        """Return what it is flown with."""
        inputs = ["keyboard"] if self._terminal is not None and self._terminal.is_open else []
        if self._joystick.is_connected(now=time.monotonic()):
            inputs.append("joystick")
        mode = ("mode", "position" if self._position_mode else "velocity")
        if not inputs:
            return Health(level=WARN, text="waiting for a joystick", values=[mode])
        return Health(level=OK, text=" and ".join(inputs), values=[mode])


main = functools.partial(run, TeleopNode)

if __name__ == "__main__":
    sys.exit(main())
