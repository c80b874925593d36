"""Parameters of the recorder node."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, parameter
from quad_mpc_ros.ros.topics import RECORDED


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(Configuration):
    """What is recorded, and where to."""

    owner = "recorder"

    directory: str = parameter(
        "", doc="Folder of the bag, which must not exist yet; empty is rosbag2_<date and time>."
    )
    topics: tuple[str, ...] = parameter(
        tuple(topic.name for topic in RECORDED),
        doc="Topics to record, resolved in the namespace of the node.",
    )
    nodes: tuple[str, ...] = parameter(
        ("mpc", "simulator", "reference", "recorder"),
        doc="Nodes whose parameters are stored in the bag.",
    )
    compression: str = parameter(
        "zstd", doc="Compression of the chunks.", choices=("none", "zstd", "lz4")
    )
