"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

A bag is written by :class:`BagWriter` and read by :class:`BagReader`; messages are made, encoded
and decoded by :class:`RosbagsMessages`; :func:`schema_for` knows their definitions. Every
failure is a :class:`BagError`. Nothing here imports rclpy or a message package.
"""

from quad_mpc_ros.messages.codec import RosbagsMessages
from quad_mpc_ros.messages.errors import BagError
from quad_mpc_ros.messages.schemas import SHIPPED_TYPES, MessageSchema, schema_for
from quad_mpc_ros.recordings.mcap_output import Compression
from quad_mpc_ros.recordings.qos_profile import INFINITE_NS, QosProfile
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage, TopicInfo
from quad_mpc_ros.recordings.writer import FLUSH_PERIOD_S, BagWriter, Split

__all__ = [
    "FLUSH_PERIOD_S",
    "INFINITE_NS",
    "SHIPPED_TYPES",
    "BagError",
    "BagReader",
    "BagWriter",
    "Compression",
    "MessageSchema",
    "QosProfile",
    "RecordedMessage",
    "RosbagsMessages",
    "Split",
    "TopicInfo",
    "schema_for",
]
