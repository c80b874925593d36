"""Which topics of a bag are selected for playing, and which of them can be played."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.messages.topics import CLOCK
from quad_mpc_ros.recordings.config import PlayerConfig, TopicSelection
from quad_mpc_ros.recordings.reader import BagReader, TopicInfo
from quad_mpc_ros.ros.messages import message_class

_SHOWN = 10


@dataclass(frozen=True, kw_only=True)
class PlayedTopics:
    """The topics that can be played, and why other selected ones cannot."""

    playable: Mapping[str, TopicInfo]
    refused: Mapping[str, str]


def played_topics(reader: BagReader, config: PlayerConfig) -> PlayedTopics:
    """Return the topics that a configuration selects.

    Raises :class:`BagError` when a given topic is not in the bag, and when none can be played.
    """
    # Some recorders leave the slash out.
    names = tuple(
        name if name in reader.topics else f"/{name.lstrip('/')}" for name in config.topics
    )
    for name in names:
        if name not in reader.topics:
            raise BagError(f"{config.bag}: topic {name} is not in it: {_listed(reader.topics)}")
    selection = TopicSelection(
        names=names,
        pattern=config.topics_regex,
        everything=not names and not config.topics_regex,
    )
    wanted = {
        topic: info
        for topic, info in reader.topics.items()
        if selection.includes(topic) and not (config.clock_rate and topic == CLOCK.name)
    }
    refused = {topic: why for topic, info in wanted.items() if (why := _obstacle(topic, info))}
    playable = {topic: info for topic, info in wanted.items() if topic not in refused}
    if not any(info.message_count for info in playable.values()):
        raise BagError(f"{config.bag}: {_nothing_to_play(reader, wanted, refused, config)}")
    return PlayedTopics(playable=playable, refused=refused)


def _obstacle(topic: str, info: TopicInfo) -> str:
    """Return why a topic cannot be played, or nothing."""
    if info.encoding != "cdr":
        return f"its messages are encoded as {info.encoding!r}, expected 'cdr'"
    try:
        message_class(info.type_name)
        type_hash = schema_for(info.type_name).type_hash
    except (ImportError, AttributeError, ValueError, BagError):
        return f"its type {info.type_name!r} is not installed"
    if info.type_hash and info.type_hash != type_hash:
        return f"its type {info.type_name} has changed since it was recorded"
    return ""


def _nothing_to_play(
    reader: BagReader,
    wanted: Mapping[str, TopicInfo],
    refused: Mapping[str, str],
    config: PlayerConfig,
) -> str:
    if not any(info.message_count for info in reader.topics.values()):
        return "there is no message in it"
    if not wanted:
        return f"no topic matches {config.topics_regex!r}: {_listed(reader.topics)}"
    if refused:
        topic, why = next(iter(refused.items()))
        return f"no topic can be played; {topic}: {why}"
    return f"no message on {_listed(wanted)}"


def _listed(topics: Mapping[str, TopicInfo]) -> str:
    shown = ", ".join(sorted(topics)[:_SHOWN])
    return shown if len(topics) <= _SHOWN else f"{shown}, …"
