"""The stacks' messages without their packages: their fields and constants, strictly kept."""

from __future__ import annotations

import functools
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.setup_py import executable
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HEADER = "std_msgs/Header header\n"

# As the stacks define them, in the order of their fields.
DEFINITIONS = {
    "px4_msgs/msg/VehicleOdometry": """
        uint32 MESSAGE_VERSION=0
        uint64 timestamp
        uint64 timestamp_sample
        uint8 pose_frame
        float32[3] position
        float32[4] q
        uint8 velocity_frame
        float32[3] velocity
        float32[3] angular_velocity
        float32[3] position_variance
        float32[3] orientation_variance
        float32[3] velocity_variance
        uint8 reset_counter
        int8 quality""",
    "px4_msgs/msg/VehicleStatus": """
        uint32 MESSAGE_VERSION=4
        uint64 timestamp
        uint8 arming_state
        uint8 nav_state
        bool failsafe""",
    "px4_msgs/msg/VehicleCommandAck": """
        uint32 MESSAGE_VERSION=1
        uint64 timestamp
        uint32 command
        uint8 result""",
    "px4_msgs/msg/BatteryStatus": """
        uint32 MESSAGE_VERSION=1
        uint64 timestamp
        bool connected
        float32 voltage_v""",
    "px4_msgs/msg/OffboardControlMode": """
        uint64 timestamp
        bool position
        bool velocity
        bool acceleration
        bool attitude
        bool body_rate
        bool thrust_and_torque
        bool direct_actuator""",
    "px4_msgs/msg/VehicleRatesSetpoint": """
        uint32 MESSAGE_VERSION=0
        uint64 timestamp
        float32 roll
        float32 pitch
        float32 yaw
        float32[3] thrust_body
        bool reset_integral""",
    "px4_msgs/msg/VehicleCommand": """
        uint32 MESSAGE_VERSION=0
        uint64 timestamp
        float32 param1
        float32 param2
        float32 param3
        float32 param4
        float64 param5
        float64 param6
        float32 param7
        uint32 command
        uint8 target_system
        uint8 target_component
        uint8 source_system
        uint16 source_component
        uint8 confirmation
        bool from_external""",
    "mavros_msgs/msg/State": HEADER
    + """
        bool connected
        bool armed
        bool guided
        bool manual_input
        string mode
        uint8 system_status""",
    "mavros_msgs/msg/AttitudeTarget": HEADER
    + """
        uint8 type_mask
        geometry_msgs/Quaternion orientation
        geometry_msgs/Vector3 body_rate
        float32 thrust""",
    "rosflight_msgs/msg/Status": HEADER
    + """
        bool armed
        bool failsafe
        uint16 rc_override
        bool offboard
        uint8 control_mode
        uint8 error_code
        int16 num_errors
        int16 loop_time_us""",
    "rosflight_msgs/msg/Command": HEADER
    + """
        uint8 mode
        uint16 ignore
        float32[10] u""",
    "rosflight_msgs/msg/BatteryStatus": HEADER
    + """
        float32 voltage
        float32 current""",
    "rosflight_msgs/msg/SimState": HEADER
    + """
        geometry_msgs/Pose pose
        geometry_msgs/Twist twist
        geometry_msgs/Accel acceleration""",
    "roscopter_msgs/msg/State": HEADER
    + """
        float32 p_n
        float32 p_e
        float32 p_d
        float32 v_x
        float32 v_y
        float32 v_z
        float32 p
        float32 q
        float32 r
        float32 phi
        float32 theta
        float32 psi
        float32 b_x
        float32 b_y
        float32 b_z
        geometry_msgs/Quaternion quat
        float64 initial_lat
        float64 initial_lon
        float64 initial_alt""",
    "as2_msgs/msg/Thrust": HEADER
    + """
        float32 thrust
        float32 thrust_normalized""",
    "as2_msgs/msg/ControlMode": HEADER
    + """
        int8 yaw_mode
        int8 control_mode""",
    "as2_msgs/msg/PlatformStatus": "int8 state",
    "as2_msgs/msg/PlatformInfo": HEADER
    + """
        bool connected
        bool armed
        bool offboard
        as2_msgs/PlatformStatus status
        as2_msgs/ControlMode current_control_mode""",
    "crazyflie_interfaces/msg/Status": HEADER
    + """
        uint16 supervisor_info
        float32 battery_voltage
        uint8 pm_state
        uint8 rssi""",
    # Requests of services, as if they were messages.
    "mavros_msgs/srv/SetMode": "uint8 base_mode\nstring custom_mode",
    "mavros_msgs/srv/CommandBool": "bool value",
    "std_srvs/srv/SetBool": "bool data",
    "as2_msgs/srv/SetControlMode": "as2_msgs/ControlMode control_mode",
    "crazyflie_interfaces/srv/Arm": "bool arm",
}

_STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in DEFINITIONS.items():
    _STORE.register(get_types_from_msg(_text, _name.replace("/srv/", "/msg/")))


class StrictMessage:
    """Has the fields of its definition and no others, of their types, as rclpy's messages do."""

    FIELDS: dict[str, Any]
    COMPOUND: tuple[str, ...]  # whose values no two messages share

    def __init__(self) -> None:
        for name in self.COMPOUND:
            object.__setattr__(self, name, _empty(self.FIELDS[name]))

    def __setattr__(self, name: str, value: Any) -> None:
        kind = self.FIELDS[name]
        if kind[0] is Nodetype.ARRAY:
            value = np.array(value, dtype=kind[1][0][1][0])
            assert len(value) == kind[1][1], (name, value)
        elif kind[0] is Nodetype.BASE:
            value = _checked(kind[1][0], value)
        object.__setattr__(self, name, value)


def _checked(base: str, value: Any) -> Any:
    if base in ("bool", "string"):
        assert isinstance(value, bool if base == "bool" else str), (base, value)
        return value
    if base.startswith("float"):
        assert isinstance(value, float), (base, value)
        return float(np.float32(value)) if base == "float32" else value
    assert type(value) is int, (base, value)
    low, high = _bounds(base)
    assert low <= value <= high, (base, value)
    return value


@functools.cache
def _bounds(base: str) -> tuple[int, int]:
    return int(np.iinfo(base).min), int(np.iinfo(base).max)


def _empty(kind: Any) -> Any:
    node, detail = kind
    if node is Nodetype.NAME:
        return new_message(detail)
    if node is Nodetype.ARRAY:
        (_, (base, _)), length = detail
        return np.zeros(length, dtype=base)
    if node is Nodetype.SEQUENCE:
        return []
    empty: dict[str, Any] = {"bool": False, "string": ""}
    return empty.get(detail[0], 0.0 if detail[0].startswith("float") else 0)


_CLASSES: dict[str, type[StrictMessage]] = {}


def new_message(type_name: str) -> Any:
    if type_name not in _CLASSES:
        constants, fields = _STORE.fielddefs[type_name.replace("/srv/", "/msg/")]
        members: dict[str, Any] = {name: value for name, _, value in constants}
        plain = {name: kind for name, kind in fields if kind[0] is Nodetype.BASE}
        members |= {name: _empty(kind) for name, kind in plain.items()}
        members["FIELDS"] = dict(fields)
        members["COMPOUND"] = tuple(name for name, _ in fields if name not in plain)
        _CLASSES[type_name] = type(type_name.rsplit("/", 1)[-1], (StrictMessage,), members)
    return _CLASSES[type_name]()


@pytest.fixture(scope="session")
def new() -> Callable[[str], Any]:
    """Make empty messages and requests by type name."""
    return new_message


# What makes a message of the stack one that is taken; the rest is as in an empty one.
SOUND: dict[str, dict[str, Any]] = {
    "px4_msgs/msg/VehicleOdometry": {
        "pose_frame": 1,
        "velocity_frame": 1,
        "q": [1.0, 0.0, 0.0, 0.0],
    },
    "px4_msgs/msg/VehicleStatus": {"nav_state": 14, "arming_state": 2},
    "px4_msgs/msg/BatteryStatus": {"voltage_v": 15.0},
    "mavros_msgs/msg/State": {"connected": True, "armed": True, "mode": "OFFBOARD"},
    "nav_msgs/msg/Odometry": {"pose.pose.orientation.w": 1.0},
    "sensor_msgs/msg/BatteryState": {"voltage": 15.0},
    "rosflight_msgs/msg/Status": {"armed": True, "offboard": True},
    "rosflight_msgs/msg/BatteryStatus": {"voltage": 15.0},
    "rosflight_msgs/msg/SimState": {"pose.orientation.w": 1.0},
    "roscopter_msgs/msg/State": {"quat.w": 1.0},
    "geometry_msgs/msg/PoseStamped": {"pose.orientation.w": 1.0},
    "geometry_msgs/msg/TwistStamped": {"header.frame_id": "base_link", "twist.linear.z": 0.4},
    "as2_msgs/msg/PlatformInfo": {
        "connected": True,
        "armed": True,
        "offboard": True,
        "current_control_mode.control_mode": 6,
    },
    "crazyflie_interfaces/msg/Status": {"supervisor_info": 2, "battery_voltage": 4.0},
}


def sound_message(type_name: str, stamp_ns: int) -> Any:
    """Make a message of a vehicle that stands level, armed, and takes setpoints."""
    message = new_message(type_name)
    for name, value in SOUND.get(type_name, {}).items():
        *groups, last = name.split(".")
        setattr(functools.reduce(getattr, groups, message), last, value)
    if hasattr(message, "timestamp"):
        message.timestamp = stamp_ns // 1000
    else:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


@pytest.fixture(scope="session")
def sound() -> Callable[[str, int], Any]:
    """Make messages of the stacks by type name and stamp [ns], as they are when all is well."""
    return sound_message


@pytest.fixture(scope="session")
def matching() -> float:
    """How long [s] until a client that has found its service has been found by it.

    Before that it would get no answer.
    """
    return 0.3


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start nodes by executable, like ``mpc_node``, and arguments; they end with the test."""

    with ExitStack() as stack:

        def started(name: str, *arguments: str) -> subprocess.Popen[bytes]:
            log = stack.enter_context((tmp_path / f"{name}.log").open("wb"))
            command = [*executable(name), "--ros-args", *arguments]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            stack.callback(_end, process)
            return process

        yield started


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
