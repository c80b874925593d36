"""Our topics in a bag, whatever namespace they were recorded in."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from quad_mpc_ros.bags import BagError, BagReader, RecordedMessage
from quad_mpc_ros.ros.topics import Topic


def messages_by_topic(bag: Path, topics: Collection[Topic]) -> dict[Topic, list[RecordedMessage]]:
    """Return the messages of each topic, in log-time order; none for one that is not there.

    Raises :class:`BagError` when the bag cannot be read or a topic is there more than once.
    """
    reader = BagReader(bag)
    topic_of = {name: topic for topic in topics for name in _names_of(bag, reader, topic)}
    found: dict[Topic, list[RecordedMessage]] = {topic: [] for topic in topics}
    for message in reader.messages(topic_of.keys()):
        found[topic_of[message.topic]].append(message)
    return found


def _names_of(bag: Path, reader: BagReader, topic: Topic) -> list[str]:
    """Return the full name of a topic as a list of one, or none when it was not recorded."""
    names = [
        name
        for name, info in reader.topics.items()
        if f"/{name}".endswith(f"/{topic.name}")
        and info.type_name == topic.type_name
        and info.message_count > 0
    ]
    if len(names) > 1:
        raise BagError(
            f"{bag}: {', '.join(sorted(names))} all end in /{topic.name}: "
            "expected a bag of one vehicle, record each vehicle in its own"
        )
    return names
