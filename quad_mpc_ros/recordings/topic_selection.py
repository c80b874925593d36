"""Which topics are meant: by name, by regular expression, or all."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TopicSelection:
    """Topics named, and those that match; full names throughout.

    A regular expression need only be found somewhere in the name, as with ``ros2 bag``. Hidden
    topics, with a part that begins with an underscore, are meant only when they are named.
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
        """Whether ``topic`` is meant; what is excluded is not, even when it is named."""
        if self.exclude and re.search(self.exclude, topic):
            return False
        if topic in self.names:
            return True
        if "/_" in topic:
            return False
        return self.everything or bool(self.pattern and re.search(self.pattern, topic))


def regex_error(pattern: str) -> str:
    """Return what is wrong with a regular expression, or nothing."""
    try:
        re.compile(pattern)
    except re.error as error:
        return str(error)
    return ""
