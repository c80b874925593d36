"""Selection of the topics of a bag to play."""

from __future__ import annotations

from collections.abc import Collection

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import schema_for
from quad_mpc_ros.messages.topics import CLOCK
from quad_mpc_ros.recordings.config import PlayerConfig
from quad_mpc_ros.recordings.mcap_file import TopicInfo
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.ros.messages import message_class

_MAX_LISTED = 10


def played_topics(
    reader: BagReader, config: PlayerConfig
) -> tuple[dict[str, TopicInfo], dict[str, str]]:
    """Return the selected topics that can be played, and the errors of the others.

    Raises :class:`BagError` if a given topic is not in the bag, or none can be played.
    """
    # Some recorders omit the slash.
    names = tuple(
        name if name in reader.topics else f"/{name.lstrip('/')}" for name in config.topics
    )
    for name in names:
        if name not in reader.topics:
            raise BagError(f"{config.bag}: no topic {name} in the bag: {_listed(reader.topics)}")
    playable: dict[str, TopicInfo] = {}
    refused: dict[str, str] = {}
    for topic, info in reader.topics.items():
        if (names and topic not in names) or (config.clock_rate and topic == CLOCK.name):
            continue
        if why := _playback_error(info):
            refused[topic] = why
        else:
            playable[topic] = info
    if not any(info.message_count for info in playable.values()):
        why = "".join(f"; {topic}: {reason}" for topic, reason in refused.items())
        raise BagError(
            f"{config.bag}: contains no playable message on the selected topics; its topics: "
            f"{_listed(reader.topics)}{why}"
        )
    return playable, refused


def _playback_error(info: TopicInfo) -> str:
    """Return the reason why a topic cannot be played, or an empty string."""
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


def _listed(topics: Collection[str]) -> str:
    shown = ", ".join(sorted(topics)[:_MAX_LISTED]) or "no topic"
    return shown if len(topics) <= _MAX_LISTED else f"{shown}, …"
