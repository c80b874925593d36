"""Quality of service as rosbag2 records it, without rclpy."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import yaml

from quad_mpc_ros.configuration import BagError, ros_yaml

History = Literal["system_default", "keep_last", "keep_all", "unknown"]
Reliability = Literal["system_default", "reliable", "best_effort", "unknown", "best_available"]
Durability = Literal["system_default", "transient_local", "volatile", "unknown", "best_available"]
Liveliness = Literal["system_default", "automatic", "manual_by_topic", "unknown", "best_available"]

INFINITE_NS = 2**63 - 1
"""``RMW_DURATION_INFINITE`` [ns]."""

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class QosProfile:
    """The quality of service one publisher offers.

    The words are those of ``rmw/qos_string_conversions.h`` and the durations are in nanoseconds.
    The defaults are those of ``rmw_qos_profile_default`` as a publisher on Fast DDS reports them.
    Raises :class:`BagError` for a word or a number that rosbag2 would not read back.
    """

    history: History = "keep_last"
    depth: int = 10
    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    deadline: int = INFINITE_NS
    lifespan: int = INFINITE_NS
    liveliness: Liveliness = "automatic"
    liveliness_lease_duration: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        for name, words in _WORDS.items():
            if getattr(self, name) not in words:
                raise BagError(
                    f"QoS {name}: given {getattr(self, name)!r}, expected one of "
                    + ", ".join(words)
                )
        for name in ("depth", *_DURATIONS):
            if not 0 <= getattr(self, name) <= INFINITE_NS:
                raise BagError(
                    f"QoS {name}: given {getattr(self, name)}, expected 0 to {INFINITE_NS}"
                )

    def as_mapping(self) -> dict[str, object]:
        """Return the profile as metadata version 9 spells it, keys in rosbag2's order."""
        return {
            name: _rmw_time(value) if name in _DURATIONS else value
            for name, value in dataclasses.asdict(self).items()
        }


def parse_qos_profiles(text: str) -> tuple[QosProfile, ...]:
    """Return the profiles of the channel metadata ``offered_qos_profiles``, one a publisher.

    Reads the words of version 9 and the numbers of older bags, rmw's enumerations. Raises
    :class:`BagError` for anything else.
    """
    try:
        entries = ros_yaml.read(text) or []
        return tuple(_parsed(entry) for entry in entries)
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise BagError(f"offered_qos_profiles: expected those of rosbag2: {reason}") from error


def _parsed(entry: Mapping[str, Any]) -> QosProfile:
    fields: dict[str, Any] = {}
    for name in QosProfile.__dataclass_fields__:
        value = entry[name]
        if name in _NUMBERS and isinstance(value, int):
            value = _NUMBERS[name][value]
        elif isinstance(value, dict):
            value = min(int(value["sec"]) * _NS_PER_S + int(value["nsec"]), INFINITE_NS)
        fields[name] = value
    return QosProfile(**fields)


_WORDS: dict[str, tuple[str, ...]] = {
    "history": get_args(History),
    "reliability": get_args(Reliability),
    "durability": get_args(Durability),
    "liveliness": get_args(Liveliness),
}
# The enumerations of rmw/types.h; the liveliness 2, by node, is gone.
_NUMBERS = {name: dict(enumerate(words)) for name, words in _WORDS.items()}
_NUMBERS["liveliness"] = dict(zip((0, 1, 3, 4, 5), get_args(Liveliness), strict=True))

_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


def _rmw_time(duration_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration_ns, _NS_PER_S)
    return {"sec": seconds, "nsec": nanoseconds}
