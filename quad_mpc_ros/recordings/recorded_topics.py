"""Topics in a bag: ours in whatever namespace they were recorded in, or those that are named."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage

_MOST_LISTED = 12


def messages_by_topic(
    bag: Path, topics: Collection[Topic], *, names: Mapping[Topic, str] | None = None
) -> dict[Topic, list[RecordedMessage]]:
    """Return the messages of each topic, in log-time order; none for one that is not there.

    ``names`` are full names of topics that are not to be looked for by our name. Raises
    :class:`BagError` when the bag cannot be read, when a topic is there more than once, and when
    a named one is not there or of another type.
    """
    reader, given = BagReader(bag), names or {}
    topic_of = {
        name: topic
        for topic in topics
        for name in (
            [_checked(bag, reader, topic, given[topic])]
            if topic in given
            else _names_of(bag, reader, topic)
        )
    }
    found: dict[Topic, list[RecordedMessage]] = {topic: [] for topic in topics}
    for message in reader.messages(topic_of.keys()):
        found[topic_of[message.topic]].append(message)
    return found


def listed_topics(bag: Path) -> str:
    """Return the topics of a bag and their types as text for an error."""
    topics = BagReader(bag).topics
    shown = [
        f"{name} ({info.type_name or 'no type'})"
        for name, info in sorted(topics.items())[:_MOST_LISTED]
    ]
    more = len(topics) - len(shown)
    return ", ".join(shown + ([f"{more} more"] if more else [])) or "no topic"


def _checked(bag: Path, reader: BagReader, topic: Topic, name: str) -> str:
    """Return the full name of a topic that was asked for by name."""
    full = name if name.startswith("/") or name in reader.topics else f"/{name}"
    info = reader.topics.get(full)
    if info is None:
        raise BagError(f"{bag}: topic {name} is not in it; it holds {listed_topics(bag)}")
    if info.type_name != topic.type_name:
        raise BagError(
            f"{bag}: topic {full} is of type {info.type_name or 'unknown'}, "
            f"expected {topic.type_name}"
        )
    return full


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
