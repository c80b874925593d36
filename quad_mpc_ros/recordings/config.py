"""Parameters of the recorder and the player, and the topics that they choose."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    ManagedConfiguration,
    parameter,
)
from quad_mpc_ros.messages.topics import RECORDED


@dataclass(frozen=True, kw_only=True)
class TopicSelection:
    """Topics by name and by pattern; full names throughout.

    A regular expression need only be found somewhere in the name, as with ``ros2 bag``. Hidden
    topics, with a part that begins with an underscore, are chosen only by name.
    """

    names: Collection[str] = ()
    pattern: str = ""
    exclude: str = ""
    everything: bool = False

    @property
    def by_name_only(self) -> bool:
        """Whether the topics are known without looking at those there are."""
        return not (self.everything or self.pattern)

    def includes(self, topic: str) -> bool:
        """Whether ``topic`` is chosen; what is excluded is not, even when it is named."""
        if self.exclude and re.search(self.exclude, topic):
            return False
        if topic in self.names:
            return True
        if "/_" in topic:
            return False
        return self.everything or bool(self.pattern and re.search(self.pattern, topic))


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(ManagedConfiguration):
    """What is recorded, and where to."""

    owner = "recorder"

    directory: str = parameter(
        "", doc="Folder of the bag, which must not exist yet; empty is rosbag2_<date and time>."
    )
    topics: tuple[str, ...] = parameter(
        tuple(topic.name for topic in RECORDED),
        doc="Topics to record, resolved in the namespace of the node.",
    )
    topics_regex: str = parameter(
        "", doc="Record topics too in whose full name this regular expression is found."
    )
    topics_exclude_regex: str = parameter(
        "", doc="Do not record topics in whose full name this regular expression is found."
    )
    all: bool = parameter(False, doc="Record every topic but hidden ones.")
    nodes: tuple[str, ...] = parameter(
        ("mpc", "simulator", "reference", "recorder"),
        doc="Nodes whose parameters are stored in the bag.",
        advanced=True,
    )
    compression: str = parameter(
        "zstd", doc="Compression of the chunks.", choices=("none", "zstd", "lz4")
    )
    max_bag_size: int = parameter(
        0, minimum=0, unit="bytes", doc="Size at which a new file is begun; 0 is never."
    )
    max_bag_duration: float = parameter(
        0.0, minimum=0.0, unit="s", doc="Duration after which a new file is begun; 0 is never."
    )
    sync: bool = parameter(
        True,
        doc="Wait at each flush, twice a second, until the disk has the data: what was flushed "
        "then survives a power failure too.",
        advanced=True,
    )

    def check(self) -> None:
        """Refuse what is no regular expression."""
        for name in ("topics_regex", "topics_exclude_regex"):
            value = getattr(self, name)
            try:
                re.compile(value)
            except re.error as error:
                expected = f"a regular expression ({error})"
                raise ConfigurationError(f"{self.owner}.{name}", value, expected) from error


@dataclass(frozen=True, kw_only=True)
class PlayerConfig(Configuration):
    """What is played, and how fast."""

    owner = "player"

    bag: str = parameter("", doc="Folder of the bag, or one .mcap file.")
    topics: tuple[str, ...] = parameter((), doc="Full names of the topics to play; none is all.")
    rate: float = parameter(
        1.0, above=0.0, maximum=1000.0, doc="Speed, in multiples of the recorded one."
    )
    start: float = parameter(
        0.0, minimum=0.0, unit="s", doc="Time into the bag at which to start."
    )
    paused: bool = parameter(False, doc="Start paused; the service ~/resume begins.")
    delay: float = parameter(
        1.0,
        minimum=0.0,
        maximum=3600.0,
        unit="s",
        doc="Time from the creation of the publishers to the first message, in which subscribers "
        "find them.",
    )
    clock_rate: float = parameter(
        0.0,
        minimum=0.0,
        maximum=10000.0,
        unit="Hz",
        doc="Publish the recorded time on /clock at this rate, in place of a recorded /clock; 0 "
        "does not.",
    )
    progress: bool = parameter(False, doc="Show on standard error how far it is.")
