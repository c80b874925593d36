"""Simulator, a stack that speaks its own messages and keeps its own rules, bridge, and MPC.

The fake stacks convert frames by rotation matrices of their own, and fail the test when a rule of
the stack is broken: a setpoint outside of offboard mode, a missing unlock, a timeout.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.bridges.aerostack2 import Aerostack2Bridge
from quad_mpc_ros.bridges.bridge import Bridge, Outgoing, ServiceCall
from quad_mpc_ros.bridges.crazyswarm2 import Crazyswarm2Bridge
from quad_mpc_ros.bridges.mavros import MavrosBridge
from quad_mpc_ros.bridges.px4 import Px4Bridge
from quad_mpc_ros.bridges.rates import RatesBridge
from quad_mpc_ros.bridges.rosflight import RosflightBridge
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.model.vehicle import VehicleParameters
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.safety.ladder import Source
from quad_mpc_ros.simulation.closed_loop import SIMULATION_START_NS
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.sensors import OdometryStream
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.trajectories.live import LiveReference

New = Callable[[str], Any]
Spoken = Iterator[tuple[str, Any]]

SECOND = 1_000_000_000
GROUND_TIME_NS = int(1.5 * SECOND)  # before the pilot asks for anything
DURATION = 10.5
WATCH_NS = SECOND // 50
VEHICLE = VehicleParameters().vehicle()
SQUARE = ReferenceConfig()

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FROM_FLU = np.diag([1.0, -1.0, -1.0])


class FakeStack:
    """A vehicle's own software. It acts on setpoints once it is engaged and armed."""

    command_timeout = 0.5

    def __init__(self, new: New) -> None:
        self.new = new
        self.engaged = self.armed = False
        self.heard_ns: int | None = None
        self.heard_since_ns: int | None = None

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        """Yield the messages of a moment: topic and message."""
        raise NotImplementedError

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        """Take a message and return what the vehicle does of it."""
        raise NotImplementedError

    def serve(self, service: str, request: Any, now_ns: int) -> None:
        raise AssertionError(f"no service {service}")

    @property
    def acts(self) -> bool:
        return self.engaged and self.armed

    def heard(self, now_ns: int) -> None:
        if self.heard_ns is None or now_ns - self.heard_ns > SECOND // 2:
            self.heard_since_ns = now_ns
        self.heard_ns = now_ns

    def heard_for_a_second(self, now_ns: int) -> bool:
        if self.heard_ns is None or self.heard_since_ns is None:
            return False
        return now_ns - self.heard_since_ns > SECOND and now_ns - self.heard_ns < SECOND // 2

    def check_timeout(self, now_ns: int) -> None:
        if self.acts and self.heard_ns is not None:
            assert now_ns - self.heard_ns <= self.command_timeout * SECOND, "setpoints timed out"


def performed(throttle: float, p: float, q: float, r: float) -> CommandSample:
    assert 0.0 <= throttle <= 1.0
    return CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array([p, q, r]))


def wxyz_of_ned_frd(truth: OdometrySample) -> Array:
    R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
    x, y, z, w = so3.quaternion_xyzw_from_rotation(ENU_FROM_NED.T @ R_WB @ FRD_FROM_FLU)
    return np.array([w, x, y, z])


def velocity_ned(truth: OdometrySample) -> Array:
    R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
    return np.asarray(ENU_FROM_NED.T @ R_WB @ truth.v_WB_B)


def set_stamp(message: Any, stamp_ns: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)


def set_xyz(target: Any, values: Array) -> None:
    target.x, target.y, target.z = (float(value) for value in values)


def set_pose(pose: Any, truth: OdometrySample) -> None:
    set_xyz(pose.position, truth.p_WB)
    q = pose.orientation
    q.x, q.y, q.z, q.w = (float(value) for value in truth.q_WB_xyzw)


class FakePx4(FakeStack):
    """Offboard only with a running heartbeat, setpoints only then, status twice a second."""

    odom_rate = 100.0

    def __init__(self, new: New) -> None:
        super().__init__(new)
        self.status_due_ns = 0
        self.reset_counter = 0
        self.offset_ned = np.zeros(3)
        self.status_speaks = True
        self.clock_ns = 0  # by which its clock was set

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        if now_ns >= self.status_due_ns and self.status_speaks:
            yield "/fmu/out/vehicle_status_v4", self.status()
            self.status_due_ns = now_ns + SECOND // 2
        message = self.new("px4_msgs/msg/VehicleOdometry")
        message.timestamp = message.timestamp_sample = (truth.stamp_ns + self.clock_ns) // 1000
        message.pose_frame = message.velocity_frame = 1
        message.position = ENU_FROM_NED.T @ truth.p_WB + self.offset_ned
        message.q = wxyz_of_ned_frd(truth)
        message.velocity = velocity_ned(truth)
        message.angular_velocity = FRD_FROM_FLU @ truth.w_WB_B
        message.reset_counter = self.reset_counter
        yield "/fmu/out/vehicle_odometry", message

    def status(self) -> Any:
        message = self.new("px4_msgs/msg/VehicleStatus")
        message.nav_state = 14 if self.engaged else 4
        message.arming_state = 2 if self.armed else 1
        return message

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert message.timestamp == 0
        match topic:
            case "/fmu/in/offboard_control_mode":
                assert message.body_rate
                assert not (message.position or message.velocity or message.attitude)
                self.heard(now_ns)
            case "/fmu/in/vehicle_rates_setpoint":
                assert self.engaged, "a rate setpoint outside of offboard mode"
                assert self.heard_ns == now_ns, "a setpoint without its heartbeat"
                assert not message.thrust_body[:2].any()
                p, q, r = FRD_FROM_FLU @ [message.roll, message.pitch, message.yaw]
                return performed(-float(message.thrust_body[2]), p, q, r)
            case "/fmu/in/vehicle_command":
                self.obey(message, now_ns)
            case _:
                raise AssertionError(topic)
        return None

    def obey(self, message: Any, now_ns: int) -> None:
        assert message.from_external
        assert self.heard_for_a_second(now_ns), "the heartbeat has not run for a second"
        if message.command == 400:
            self.armed = message.param1 == 1.0
        else:
            assert (message.command, message.param1, message.param2) == (176, 1.0, 6.0)
            self.engaged = True
        self.status_due_ns = now_ns


class SpoolingPx4(FakePx4):
    """Lets the motors spool up for a second after arming, before it does as it is told."""

    armed_ns = 0

    @property
    def acts(self) -> bool:
        return super().acts and (self.heard_ns or 0) - self.armed_ns >= SECOND

    def obey(self, message: Any, now_ns: int) -> None:
        super().obey(message, now_ns)
        if self.armed:
            self.armed_ns = now_ns


class FakeMavros(FakeStack):
    """OFFBOARD after a second of setpoints (PX4) or GUIDED (ArduPilot); odometry at 30 Hz."""

    odom_rate = 30.0
    autopilot = "px4"
    mode = "OFFBOARD"

    def __init__(self, new: New) -> None:
        super().__init__(new)
        self.state_due_ns = 0

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        if now_ns >= self.state_due_ns:
            state = self.new("mavros_msgs/msg/State")
            state.connected, state.armed = True, self.armed
            state.mode = self.mode if self.engaged else "STABILIZE"
            yield "/mavros/state", state
            self.state_due_ns = now_ns + SECOND
        message = self.new("nav_msgs/msg/Odometry")
        set_stamp(message, truth.stamp_ns)
        message.header.frame_id, message.child_frame_id = "map", "base_link"
        set_pose(message.pose.pose, truth)
        set_xyz(message.twist.twist.linear, truth.v_WB_B)
        set_xyz(message.twist.twist.angular, truth.w_WB_B)
        yield "/mavros/local_position/odom", message

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert topic == "/mavros/setpoint_raw/attitude"
        assert message.type_mask == 128
        assert self.autopilot == "px4" or self.engaged, "a setpoint outside of GUIDED"
        self.heard(now_ns)
        w = message.body_rate
        return performed(message.thrust, w.x, w.y, w.z) if self.engaged else None

    def serve(self, service: str, request: Any, now_ns: int) -> None:
        if service == "/mavros/set_mode":
            assert (request.base_mode, request.custom_mode) == (0, self.mode)
            assert self.autopilot != "px4" or self.heard_for_a_second(now_ns)
            self.engaged = True
        else:
            assert service == "/mavros/cmd/arming"
            self.armed = request.value


class FakeArdupilot(FakeMavros):
    autopilot = "ardupilot"
    mode = "GUIDED"


class FakeRosflight(FakeStack):
    """The pilot's switches arm and hand over; 100 ms without a command drop back to RC."""

    odom_rate = 50.0
    command_timeout = 0.1

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        if now_ns > SIMULATION_START_NS + GROUND_TIME_NS:
            self.engaged = self.armed = True
        status = self.new("rosflight_msgs/msg/Status")
        status.armed = status.offboard = self.acts
        yield "/status", status
        message = self.new("roscopter_msgs/msg/State")
        set_stamp(message, truth.stamp_ns)
        north, east, down = (float(value) for value in ENU_FROM_NED.T @ truth.p_WB)
        message.p_n, message.p_e, message.p_d = north, east, down
        message.v_x, message.v_y, message.v_z = (
            float(value) for value in FRD_FROM_FLU @ truth.v_WB_B
        )
        message.p, message.q, message.r = (float(value) for value in FRD_FROM_FLU @ truth.w_WB_B)
        q = message.quat
        q.w, q.x, q.y, q.z = (float(value) for value in wxyz_of_ned_frd(truth))
        yield "/estimated_state", message

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert (topic, message.mode, message.ignore) == ("/command", 1, 0)
        assert not message.u[[0, 1, 6, 7, 8, 9]].any()
        self.heard(now_ns)
        p, q, r = FRD_FROM_FLU @ message.u[3:6]
        return performed(float(message.u[2]), p, q, r) if self.acts else None


class FakeAerostack2(FakeStack):
    """Body rates in offboard mode; thrust in newton and twist belong together."""

    odom_rate = 50.0

    def __init__(self, new: New) -> None:
        super().__init__(new)
        self.control_mode = 0
        self.thrust: Any = None

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        info = self.new("as2_msgs/msg/PlatformInfo")
        info.connected, info.armed, info.offboard = True, self.armed, self.engaged
        info.current_control_mode.control_mode = self.control_mode
        yield "/drone0/platform/info", info
        pose = self.new("geometry_msgs/msg/PoseStamped")
        set_stamp(pose, truth.stamp_ns)
        pose.header.frame_id = "earth"
        set_pose(pose.pose, truth)
        twist = self.new("geometry_msgs/msg/TwistStamped")
        set_stamp(twist, truth.stamp_ns)
        twist.header.frame_id = "drone0/base_link"
        set_xyz(twist.twist.linear, truth.v_WB_B)
        set_xyz(twist.twist.angular, truth.w_WB_B)
        yield "/drone0/self_localization/twist", twist
        yield "/drone0/self_localization/pose", pose

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert self.engaged, "a setpoint outside of offboard mode"
        assert self.control_mode == 6, "a setpoint of body rates in another control mode"
        self.heard(now_ns)
        if topic == "/drone0/actuator_command/thrust":
            self.thrust = message
            return None
        assert topic == "/drone0/actuator_command/twist"
        assert message.header.stamp.sec == self.thrust.header.stamp.sec
        assert message.header.stamp.nanosec == self.thrust.header.stamp.nanosec
        w = message.twist.angular
        lowest, highest = VEHICLE.thrust(0.0), VEHICLE.thrust(1.0)
        throttle = VEHICLE.throttle_for(min(max(self.thrust.thrust, lowest), highest))
        return performed(throttle, w.x, w.y, w.z)

    def serve(self, service: str, request: Any, now_ns: int) -> None:
        match service:
            case "/drone0/set_arming_state":
                self.armed = request.data
            case "/drone0/set_offboard_mode":
                assert self.control_mode == 6, "offboard mode before the control mode"
                self.engaged = request.data
            case "/drone0/set_platform_control_mode":
                self.control_mode = request.control_mode.control_mode
                assert request.control_mode.yaw_mode == 2
            case _:
                raise AssertionError(service)


class FakeCrazyswarm2(FakeStack):
    """Locked until a setpoint of thrust 0; rates in degrees, pitch and yaw of the old frame."""

    odom_rate = 50.0

    def __init__(self, new: New) -> None:
        super().__init__(new)
        self.unlocked = False

    @property
    def acts(self) -> bool:
        return self.unlocked

    def serve(self, service: str, request: Any, now_ns: int) -> None:
        assert service == "/cf231/arm"
        self.armed = request.arm

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        message = self.new("nav_msgs/msg/Odometry")
        set_stamp(message, truth.stamp_ns)
        message.header.frame_id = "cf231"
        set_pose(message.pose.pose, truth)
        R_WB = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
        set_xyz(message.twist.twist.linear, R_WB @ truth.v_WB_B)
        yield "/cf231/odom", message

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert topic == "/cf231/cmd_vel_legacy"
        self.heard(now_ns)
        pwm = message.linear.z
        assert 0.0 <= pwm <= 60000.0
        if pwm == 0.0:
            self.unlocked = True
            return None
        assert self.armed
        assert self.unlocked, "thrust before the unlock"
        # The server negates linear.x to pitch; the firmware then compares roll with gyro.x,
        # pitch with -gyro.y and, negated, yaw with gyro.z.
        roll_rate, pitch_rate, yaw_rate = message.linear.y, -message.linear.x, -message.angular.z
        return performed(
            pwm / 65535.0,
            math.radians(roll_rate),
            -math.radians(pitch_rate),
            math.radians(yaw_rate),
        )


class FakeRates(FakeStack):
    """Takes body rates and thrust in units of its own."""

    odom_rate = 50.0
    parameters: dict[str, str]

    @property
    def acts(self) -> bool:
        return self.heard_ns is not None

    def speak(self, truth: OdometrySample, now_ns: int) -> Spoken:
        message = self.new("nav_msgs/msg/Odometry")
        set_stamp(message, truth.stamp_ns)
        message.header.frame_id = "world"
        set_pose(message.pose.pose, truth)
        set_xyz(message.twist.twist.linear, truth.v_WB_B)
        set_xyz(message.twist.twist.angular, truth.w_WB_B)
        yield "stack_odom", message

    def hear(self, topic: str, message: Any, now_ns: int) -> CommandSample | None:
        assert topic == "rates_setpoint"
        self.heard(now_ns)
        w, thrust = message.twist.angular, message.twist.linear.z
        rates = np.array([w.x, w.y, w.z])
        if self.parameters["angle_unit"] == "deg":
            rates = rates * math.pi / 180.0
        if self.parameters["body_frame"] == "frd":
            rates, thrust = FRD_FROM_FLU @ rates, -thrust
        if self.parameters["thrust_unit"] == "mps2":
            thrust *= VEHICLE.mass
        if self.parameters["thrust_unit"] != "normalised":
            lowest, highest = VEHICLE.thrust(0.0), VEHICLE.thrust(1.0)
            thrust = VEHICLE.throttle_for(min(max(thrust, lowest), highest))
        return performed(thrust, *rates)


class FakeAgilicious(FakeRates):
    parameters = {"thrust_unit": "mps2", "body_frame": "flu", "angle_unit": "rad"}  # noqa: RUF012


class FakeOddity(FakeRates):
    parameters = {"thrust_unit": "newton", "body_frame": "frd", "angle_unit": "deg"}  # noqa: RUF012


class Bridged:
    """The stack behind its bridge. The pilot asks once, later than the MPC runs."""

    def __init__(self, bridge: Bridge, stack: FakeStack) -> None:
        self.bridge, self.stack = bridge, stack
        self.receivers = {each.topic.name: each.receive for each in bridge.subscriptions}
        self.sent_ns: list[int] = []
        self.held_until_ns = 0
        """Until when the link from the stack passes nothing on."""
        self.on_the_way: list[tuple[str, Any]] = []

    def odometries(self, truth: OdometrySample, now_ns: int) -> list[OdometrySample]:
        found = []
        self.on_the_way += self.stack.speak(truth, now_ns)
        if now_ns < self.held_until_ns:
            return []
        arriving, self.on_the_way = self.on_the_way, []
        for topic, message in arriving:
            odometry = self.receivers[topic](message, now_ns)
            if odometry is not None:
                found.append(odometry)
        return found

    def command(self, command: CommandSample, now_ns: int) -> CommandSample | None:
        done = None
        for sending in self.bridge.receive_command(command, now_ns=now_ns):
            done = self.send(sending, now_ns) or done
        self.stack.check_timeout(now_ns)
        return done if self.stack.acts else None

    def send(self, sending: Outgoing, now_ns: int) -> CommandSample | None:
        if isinstance(sending, ServiceCall):
            assert (sending.service, sending.type_name) in self.bridge.services
            self.stack.serve(sending.service, sending.request, now_ns)
            return None
        assert sending.topic in self.bridge.publications
        self.sent_ns.append(now_ns)
        return self.stack.hear(sending.topic.name, sending.message, now_ns)

    def landed(self, now_ns: int) -> bool | None:
        return self.bridge.landed(now_ns=now_ns)

    def see(self, window: ReferenceWindow, now_ns: int) -> None:
        self.bridge.receive_reference(window, now_ns=now_ns)

    def engaged(self, now_ns: int) -> bool:
        return self.bridge.engaged(now_ns=now_ns)

    def ask(self, now_ns: int) -> None:
        """Engage and, as soon as that is possible, arm."""
        if self.bridge.handover[0] == "released":
            answer = self.bridge.engage(True, now_ns=now_ns)
            assert answer.accepted, answer.text
        if self.bridge.handover[0] == "standby":
            response = self.bridge.arm(True, now_ns=now_ns)
            assert response.accepted, response.text
            for sending in (*response.calls, *response.messages):
                self.send(sending, now_ns)


class Direct:
    """No bridge: what is measured and commanded passes as it is, from a given time on."""

    def __init__(self, acts_from_ns: int) -> None:
        self.acts_from_ns = acts_from_ns

    def odometries(self, truth: OdometrySample, now_ns: int) -> list[OdometrySample]:
        return [truth]

    def command(self, command: CommandSample, now_ns: int) -> CommandSample | None:
        return command if now_ns >= self.acts_from_ns else None

    def engaged(self, now_ns: int) -> bool:
        return now_ns >= self.acts_from_ns

    def landed(self, now_ns: int) -> bool | None:
        return None

    def see(self, window: ReferenceWindow, now_ns: int) -> None:
        pass

    def ask(self, now_ns: int) -> None:
        pass


@dataclasses.dataclass
class Flight:
    """``errors`` (n,) [m] from when the reference was told that commands act, ``acting_ns``.

    ``thrust_scales`` are what the MPC believed, from its first command on.
    """

    errors: list[float]
    acting_ns: int
    controller: Controller
    sources: set[Source]
    thrust_scales: list[float]

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.errors))))


def fly(
    way: Bridged | Direct,
    *,
    odom_rate: float,
    throttle_max: float = 1.0,
    duration: float = DURATION,
    ground_time_ns: int = GROUND_TIME_NS,
    reference: ReferenceConfig = SQUARE,
    at: Callable[[int], None] = lambda now_ns: None,
) -> Flight:
    """Fly the square, which begins when commands act; ``at`` is called every time."""
    simulator = SimulatorConfig(duration=duration, odom_rate=odom_rate)
    plant = make_plant(simulator)
    controller = warmed_up(MpcConfig(throttle_max=throttle_max))
    live = LiveReference(
        reference,
        configured_trajectory(reference),
        joined=lambda: joined_trajectory(reference),
    )
    live.engage(False)
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    flight = Flight(errors=[], acting_ns=0, controller=controller, sources=set(), thrust_scales=[])
    while (sent := stream.step()) is not None:
        now_ns = SIMULATION_START_NS + sent.time_ns
        at(now_ns)
        live.observe(sent.truth)
        window = live.window(sent.truth.stamp_ns)
        assert window is not None
        way.see(window, now_ns)
        if sent.time_ns >= ground_time_ns and not flight.acting_ns:
            way.ask(now_ns)
        controller.receive_reference(window, now_ns=now_ns)
        ticks = [controller.watch(now_ns=now_ns)] if sent.time_ns % WATCH_NS == 0 else []
        for odometry in way.odometries(sent.truth, now_ns):
            controller.engage(way.engaged(now_ns))
            controller.landed(way.landed(now_ns))
            ticks.append(controller.receive_odometry(odometry, now_ns=now_ns))
        for tick in ticks:
            if tick is None or tick.command is None:
                continue
            flight.sources.add(tick.decision.source)
            flight.thrust_scales.append(tick.stats.thrust_scale)
            done = way.command(tick.command, now_ns)
            if done is not None:
                plant.apply(done)
        if not flight.acting_ns and way.engaged(now_ns):
            flight.acting_ns = now_ns
            live.engage(True)
        elif flight.acting_ns:
            flight.errors.append(float(np.linalg.norm(window.p_WB[0] - sent.truth.p_WB)))
    return flight


CASES: dict[str, tuple[type[Bridge], type[FakeStack], dict[str, str], float]] = {
    "px4": (Px4Bridge, FakePx4, {}, 1.0),
    "mavros with px4": (MavrosBridge, FakeMavros, {}, 1.0),
    "mavros with ardupilot": (MavrosBridge, FakeArdupilot, {"autopilot": "ardupilot"}, 1.0),
    "rosflight": (RosflightBridge, FakeRosflight, {}, 1.0),
    "aerostack2": (Aerostack2Bridge, FakeAerostack2, {}, 1.0),
    "crazyswarm2": (Crazyswarm2Bridge, FakeCrazyswarm2, {}, 0.9),
    "rates in m/s^2": (RatesBridge, FakeAgilicious, FakeAgilicious.parameters, 1.0),
    "rates in newton, frd, degrees": (RatesBridge, FakeOddity, FakeOddity.parameters, 1.0),
}


def bridged(case: str, new: New) -> Bridged:
    bridge, stack, parameters, _ = CASES[case]
    return Bridged(bridge(bridge.Config(**parameters), new), stack(new))


@pytest.mark.parametrize("case", list(CASES))
def test_the_square_is_flown_as_well_as_without_the_bridge(case: str, new: New) -> None:
    way = bridged(case, new)
    _, stack, _, throttle_max = CASES[case]
    flight = fly(way, odom_rate=stack.odom_rate, throttle_max=throttle_max)
    plain = fly(Direct(flight.acting_ns), odom_rate=stack.odom_rate, throttle_max=throttle_max)

    assert len(flight.errors) > 0.6 * DURATION * stack.odom_rate
    assert flight.sources == {Source.MPC}
    assert plain.acting_ns == flight.acting_ns
    assert flight.rmse <= 1.05 * plain.rmse
    assert way.bridge.take_warnings() == []
    assert way.bridge.jumps == 0


@pytest.mark.parametrize("case", list(CASES))
def test_silent_at_once_when_the_mpc_dies_or_repeats_itself(case: str, new: New) -> None:
    way = bridged(case, new)
    stack = CASES[case][1]
    last: list[CommandSample] = []
    through = way.command

    def remembering(command: CommandSample, now_ns: int) -> CommandSample | None:
        last[:] = [command]
        return through(command, now_ns)

    way.command = remembering  # type: ignore[method-assign]
    fly(way, odom_rate=stack.odom_rate, duration=3.2)
    died_ns = way.sent_ns[-1]

    # A process that hangs may still repeat itself.
    for elapsed_ns in range(0, SECOND, SECOND // 50):
        way.bridge.receive_command(last[0], now_ns=died_ns + elapsed_ns)
        if way.bridge.silence == "":
            way.sent_ns.append(died_ns + elapsed_ns)

    assert way.sent_ns[-1] - died_ns <= SECOND // 10
    assert "old" in way.bridge.silence


@pytest.mark.parametrize("case", ["px4", "mavros with px4", "crazyswarm2"])
def test_ten_seconds_disarmed_under_commands_leave_the_estimate_and_the_flight_unharmed(
    case: str, new: New
) -> None:
    """Asked to climb a little, the vehicle stays on the ground: not for lack of thrust."""
    way = bridged(case, new)
    if case == "px4":
        way.stack = SpoolingPx4(new)
    flight = fly(
        way,
        odom_rate=way.stack.odom_rate,
        throttle_max=0.9,
        ground_time_ns=10 * SECOND,
        duration=18.0,
        reference=ReferenceConfig(trajectory="hover", height=0.5, takeoff_height=0.5),
    )
    assert len(flight.thrust_scales) > 13.0 * min(way.stack.odom_rate, 50.0)
    assert flight.sources == {Source.MPC}
    assert max(abs(scale - 1.0) for scale in flight.thrust_scales) < 0.01
    # The depth at which the reference rests, and what it rises while the motors spool up.
    assert max(flight.errors) <= 0.55
    assert max(flight.errors[-50:]) <= 0.005


def test_a_reset_of_the_estimator_is_flown_on_from(new: New) -> None:
    way = bridged("px4", new)
    stack = way.stack
    assert isinstance(stack, FakePx4)

    announced = []

    def reset(now_ns: int) -> None:
        if way.bridge.announced_reset is not None:
            announced.append(way.bridge.announced_reset)
        if now_ns == SIMULATION_START_NS + 5 * SECOND:
            stack.reset_counter += 1
            stack.offset_ned = np.array([1.0, -0.5, 0.0])

    flight = fly(way, odom_rate=100.0, at=reset)
    tick = flight.controller._last_tick
    assert way.bridge.jumps == 1
    assert way.bridge.take_warnings() == [
        "the estimate steps by 1.12 m (reset_counter 0 to 1, pose_frame 1 to 1)"
    ]
    (step,) = announced
    assert np.allclose(step.step_W, [-0.5, 1.0, 0.0], atol=0.01)  # ENU
    assert abs(step.turn) < 0.01
    assert flight.sources == {Source.MPC}
    assert tick is not None
    assert tick.stats.rejected_inputs == 0
    # Where the estimator says that the square is, it is flown: shifted by the reset.
    assert max(flight.errors) < 3.1


LEMNISCATE = ReferenceConfig(trajectory="lemniscate", amplitude_x=3.0, angular_frequency=0.8)
DISTURBED_NS = SIMULATION_START_NS + 9 * SECOND


def flown_about(new: New, disturb: Callable[[Bridged], None]) -> tuple[Flight, Array]:
    """Fly the lemniscate behind PX4, disturbed once; return the errors (n,) [m] from then on."""
    way = bridged("px4", new)

    def at(now_ns: int) -> None:
        if now_ns == DISTURBED_NS:
            disturb(way)

    flight = fly(way, odom_rate=100.0, duration=13.0, reference=LEMNISCATE, at=at)
    assert flight.acting_ns
    return flight, np.array(flight.errors[(DISTURBED_NS - flight.acting_ns) // (SECOND // 100) :])


@pytest.mark.parametrize("step", [3, -3])
def test_a_clock_of_the_stack_that_is_set_is_not_felt(step: int, new: New) -> None:
    _, undisturbed = flown_about(new, lambda way: None)

    def set_clock(way: Bridged) -> None:
        assert isinstance(way.stack, FakePx4)
        way.stack.clock_ns = step * SECOND

    flight, errors = flown_about(new, set_clock)
    assert flight.sources == {Source.MPC}
    assert errors.max() < undisturbed.max() + 0.05


def test_a_link_that_stalls_for_three_tenths_of_a_second_leaves_the_vehicle_on_its_way(
    new: New,
) -> None:
    """All that it held up comes at once, late by its stamps; the last plan bridges the gap."""
    _, undisturbed = flown_about(new, lambda way: None)

    def stall(way: Bridged) -> None:
        way.held_until_ns = DISTURBED_NS + 3 * SECOND // 10

    flight, errors = flown_about(new, stall)
    assert errors.max() < undisturbed.max() + 0.05
    assert errors[-100:].max() < undisturbed[-100:].max() + 0.01
    assert flight.sources <= {Source.MPC, Source.PLAN, Source.BLIND}
    tick = flight.controller._last_tick
    assert tick is not None and tick.decision.source is Source.MPC


def test_px4_hears_nothing_when_its_status_is_lost(new: New) -> None:
    way = bridged("px4", new)
    stack = way.stack
    assert isinstance(stack, FakePx4)

    def lose(now_ns: int) -> None:
        stack.status_speaks = now_ns < SIMULATION_START_NS + 4 * SECOND

    with pytest.raises(AssertionError, match="setpoints timed out"):
        fly(way, odom_rate=100.0, at=lose)
    assert "no vehicle_status within 1.5 s" in way.bridge.silence
