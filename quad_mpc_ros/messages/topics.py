# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the package: name, type and quality of service, once for nodes and bags.

Names are relative, so a namespace makes a second vehicle and remaps work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic and its quality of service. ``latched`` keeps the last message for late joiners.

    Without ``reliable`` only the newest value matters, and lost messages are not resent. Two
    publishers of a topic with a ``single_source`` contradict each other. An ``optional`` topic may
    have no publisher for a whole flight.
    """

    name: str
    type_name: str
    reliable: bool = False
    depth: int = 1
    latched: bool = False
    single_source: bool = False
    optional: bool = False

    def in_lockstep(self) -> Topic:
        """Return the topic with the quality of service of lockstep, which loses no message.

        Reliable delivery resends lost messages. A latched topic keeps its history
        full: Fast DDS then asks for an acknowledgement with every message instead of every 3 s.
        """
        depth = max(self.depth, LOCKSTEP_DEPTH)
        return replace(self, reliable=True, latched=True, depth=depth)


LOCKSTEP_DEPTH = 20
"""History of a publisher in lockstep. The simulator waits for subscribers after half as many."""

ODOMETRY = Topic(name="odom", type_name="nav_msgs/msg/Odometry", single_source=True)
COMMAND = Topic(name="command", type_name="geometry_msgs/msg/TwistStamped", single_source=True)
# Whether the vehicle acts on commands; it does where this is not published.
ENGAGED = Topic(
    name="engaged", type_name="std_msgs/msg/Bool", reliable=True, latched=True, optional=True
)
# Whether the vehicle is on the ground; estimated where this is not published.
LANDED = Topic(
    name="landed", type_name=ENGAGED.type_name, reliable=True, latched=True, optional=True
)
# The MPC's own judgement, a word of ``control.estimation.ground_state.GroundState``.
GROUND_STATE = Topic(
    name="mpc/ground_state",
    type_name="std_msgs/msg/String",
    reliable=True,
    latched=True,
    optional=True,
)
# A step of the estimator: transform from the former frame to the new one.
ODOMETRY_RESET = Topic(
    name="odom_reset",
    type_name="geometry_msgs/msg/TransformStamped",
    reliable=True,
    depth=10,
    optional=True,
)

BATTERY = Topic(name="battery", type_name="sensor_msgs/msg/BatteryState", optional=True)

# What an accelerometer measures, in the body (FLU) with gravity, as REP 145 has it; many come
# between two odometries.
IMU = Topic(name="imu", type_name="sensor_msgs/msg/Imu", depth=100, optional=True)

# Obstacles, all optional. Sensors publish by best effort, which a reliable publisher
# satisfies too; of markers a lost one would not come again.
OBSTACLES = Topic(name="obstacles", type_name="sensor_msgs/msg/PointCloud2", optional=True)
OBSTACLE_MARKERS = Topic(
    name="obstacle_markers",
    type_name="visualization_msgs/msg/MarkerArray",
    reliable=True,
    depth=10,
    optional=True,
)

# Where the gates of a course are by now, by their numbers, as a camera finds them.
GATES = Topic(name="gates", type_name="geometry_msgs/msg/PoseArray", reliable=True, optional=True)

REFERENCE = Topic(
    name="reference",
    type_name="trajectory_msgs/msg/MultiDOFJointTrajectory",
    reliable=True,
    single_source=True,
)
REFERENCE_PATH = Topic(
    name="reference/path", type_name="nav_msgs/msg/Path", reliable=True, latched=True
)
# Requests to the reference node, which refuses what it cannot fly.
GOAL_POSE = Topic(name="goal_pose", type_name="geometry_msgs/msg/PoseStamped", reliable=True)
TRAJECTORY = Topic(name="trajectory", type_name=REFERENCE.type_name, reliable=True)
# A velocity to follow, published by teleop_twist_keyboard, teleop_twist_joy or Nav2.
VELOCITY = Topic(name="cmd_vel", type_name="geometry_msgs/msg/TwistStamped", optional=True)
REP147_NAMES = {
    TRAJECTORY.name: "command_trajectory",
    GOAL_POSE.name: "command_pose",
    VELOCITY.name: "command_velocity",
}
"""Names of REP-147 for requests to the reference node; launch files remap to these names."""
PREDICTED_PATH = Topic(name="mpc/predicted_path", type_name="nav_msgs/msg/Path")
# The half-spaces that constrain the plan near obstacles.
CORRIDOR = Topic(name="mpc/corridor", type_name=OBSTACLES.type_name, optional=True)
STATS = Topic(
    name="mpc/stats", type_name="diagnostic_msgs/msg/DiagnosticArray", reliable=True, depth=10
)
DIAGNOSTICS = Topic(name="/diagnostics", type_name=STATS.type_name, reliable=True, depth=10)
CLOCK = Topic(name="/clock", type_name="rosgraph_msgs/msg/Clock", optional=True)
# Changed parameters of all ROS nodes, with their new values.
PARAMETER_EVENTS = Topic(
    name="/parameter_events", type_name="rcl_interfaces/msg/ParameterEvent", reliable=True
)

# For viewers; tf2 broadcasters and listeners all use this name and depth.
MARKERS = Topic(
    name="visualisation/markers", type_name="visualization_msgs/msg/MarkerArray", reliable=True
)
TF = Topic(name="/tf", type_name="tf2_msgs/msg/TFMessage", reliable=True, depth=100)
TF_STATIC = Topic(
    name="/tf_static", type_name=TF.type_name, reliable=True, depth=100, latched=True
)

# In the bag of a resolved flight: the commands that were flown.
RECORDED_COMMAND = Topic(name="recorded_command", type_name=COMMAND.type_name)

RECORDED = (
    ODOMETRY,
    ODOMETRY_RESET,
    REFERENCE,
    COMMAND,
    VELOCITY,
    ENGAGED,
    LANDED,
    GROUND_STATE,
    BATTERY,
    IMU,
    OBSTACLE_MARKERS,
    GATES,
    PREDICTED_PATH,
    CORRIDOR,
    REFERENCE_PATH,
    STATS,
    DIAGNOSTICS,
    CLOCK,
    PARAMETER_EVENTS,
)
"""The topics that a recorder records by default."""
OPTIONAL = tuple(topic for topic in RECORDED if topic.optional)
"""The recorded topics that may have no publisher for a whole flight."""
