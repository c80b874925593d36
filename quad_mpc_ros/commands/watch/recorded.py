"""Watching a recorded bag at the pace of its flight, or its end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quad_mpc_ros.commands.watch.screen import Screen
from quad_mpc_ros.commands.watch.vehicle import WATCHED, Arrival, Vehicles
from quad_mpc_ros.commands.watch.view import looked_at
from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.topics import DIAGNOSTICS, STATS, Topic
from quad_mpc_ros.recordings.reader import BagReader, RecordedMessage

_ROSOUT = "/rosout"


def watch_bag(
    bag: Path, screen: Screen, *, namespaces: Sequence[str] | None, rate: float, interval: float
) -> bool:
    """Show a bag from its beginning to its end; return whether there was a vehicle in it.

    ``interval`` [s] is that of pictures on the wall clock.
    """
    reader = BagReader(bag)
    vehicles = Vehicles(namespaces)
    takers = _takers(reader, vehicles)
    if reader.span is None or not takers:
        raise BagError(f"{bag}: no vehicle in it: expected a topic {STATS.name}, in any namespace")
    begin_ns, now, due = reader.span.start_ns, 0.0, 0.0
    began = time.monotonic()
    with screen:
        for message in reader.messages([*takers, DIAGNOSTICS.name, _ROSOUT]):
            now = 1e-9 * (message.log_time_ns - begin_ns)
            while now >= due and not screen.stopped:
                views = looked_at(vehicles, due)
                if not screen.once:
                    screen.sleep(began + due / rate - time.monotonic())
                    screen.show(views, title=_title(bag, due))
                due += interval * rate
            if screen.stopped:
                return True
            _take(message, takers, vehicles, now)
        screen.show(looked_at(vehicles, now), title=_title(bag, now))
    return True


def _takers(reader: BagReader, vehicles: Vehicles) -> dict[str, tuple[str, Topic]]:
    """Return of each watched name in the bag the vehicle and the topic."""
    namespaces = [
        name.removesuffix(STATS.name).strip("/")
        for name, info in reader.topics.items()
        if f"/{name}".endswith(f"/{STATS.name}") and info.type_name == STATS.type_name
    ]
    found = {}
    for namespace in namespaces:
        if vehicles.of(namespace) is None:
            continue
        for topic in WATCHED:
            name = f"/{namespace}/{topic.name}" if namespace else f"/{topic.name}"
            info = reader.topics.get(name)
            if info is not None and info.type_name == topic.type_name:
                found[name] = (namespace, topic)
    return found


def _take(
    message: RecordedMessage,
    takers: dict[str, tuple[str, Topic]],
    vehicles: Vehicles,
    seconds: float,
) -> None:
    if message.topic in takers:
        namespace, topic = takers[message.topic]
        vehicle = vehicles.of(namespace)
        assert vehicle is not None

        def decode() -> Any:
            return message.message

        vehicle.take(topic, Arrival(seconds=seconds, data=message.data, decode=decode))
    elif message.topic == DIAGNOSTICS.name:
        vehicles.take_diagnostics(message.message, seconds=seconds)
    else:
        vehicles.take_log(message.message)


def _title(bag: Path, now: float) -> str:
    return f"{bag}, {now:.1f} s"
