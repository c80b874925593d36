# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the recorder and the player."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration import (
    Configuration,
    ManagedConfiguration,
    parameter,
)
from quad_mpc_ros.messages.topics import RECORDED


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(ManagedConfiguration):
    """Parameters of the recorder."""

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
        advanced=True,
    )
    compression: str = parameter(
        "zstd", doc="Compression of the chunks.", choices=("none", "zstd", "lz4")
    )
    sync: bool = parameter(
        True,
        doc="Wait at each flush, twice a second, until the data is on the disk, so that flushed "
        "data also survives a power failure.",
        advanced=True,
    )


@dataclass(frozen=True, kw_only=True)
class PlayerConfig(Configuration):
    """Parameters of the player."""

    owner = "player"

    bag: str = parameter("", doc="Folder of the bag, or one .mcap file.")
    topics: tuple[str, ...] = parameter((), doc="Full names of topics to play; if empty, all.")
    rate: float = parameter(
        1.0, above=0.0, maximum=1000.0, doc="Playback speed relative to the recorded speed."
    )
    start: float = parameter(
        0.0, minimum=0.0, unit="s", doc="Time into the bag at which to start."
    )
    delay: float = parameter(
        1.0,
        minimum=0.0,
        maximum=3600.0,
        unit="s",
        doc="Time from the creation of the publishers to the first message, so that subscribers "
        "can connect.",
    )
    clock_rate: float = parameter(
        0.0,
        minimum=0.0,
        maximum=10000.0,
        unit="Hz",
        doc="Publish the recorded time on /clock at this rate, instead of a recorded /clock; 0 "
        "disables it.",
    )
    progress: bool = parameter(False, doc="Show the progress on standard error.")
