"""What every registered bridge obeys."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from fixtures.bridges import BRIDGES, SECOND, T0, command, ready_to_fly, topics

from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.ros.bridges.bridge import Bridge, SwitchedBridge

New = Callable[[str], Any]


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_passes_a_fresh_command_and_says_so(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.receive_command(command(T0 - SECOND // 100), now_ns=T0)
    assert (bridge.silence, bridge.commands, bridge.passed) == ("", 1, 1)


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (command(T0 - SECOND // 9), "0.111 s old"),
        (command(T0 + SECOND // 9), "-0.111 s old"),
        (command(T0, throttle=math.nan), "not finite"),
        (command(T0, w=(math.inf, 0.0, 0.0)), "not finite"),
        (command(T0, throttle=1.1), "outside"),
        (command(T0, throttle=-0.1), "outside"),
        (command(T0, w=(-101.0, 0.0, 0.0)), "101 rad/s"),
    ],
)
def test_drops_stale_and_invalid_commands(
    kind: type[Bridge], new: New, made: CommandSample, reason: str
) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.receive_command(made, now_ns=T0) == []
    assert reason in bridge.silence


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_sends_nothing_without_status(kind: type[Bridge], new: New) -> None:
    bridge = kind(kind.Config(), new)
    assert bridge.receive_command(command(T0), now_ns=T0) == []
    assert bridge.silence


@pytest.mark.parametrize(
    "kind", [each for each in BRIDGES.values() if not issubclass(each, SwitchedBridge)]
)
def test_silent_once_status_is_lost(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    later = T0 + 4 * SECOND
    assert bridge.receive_command(command(later), now_ns=later) == []


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_every_topic_and_service_is_of_a_package_that_it_names(
    kind: type[Bridge], new: New
) -> None:
    bridge = kind(kind.Config(), new)
    own = {"geometry_msgs", "nav_msgs", "rcl_interfaces", "sensor_msgs", "std_srvs"}
    known = {*kind.packages, *own}
    named = [each.topic for each in bridge.subscriptions] + list(bridge.publications)
    types = [topic.type_name for topic in named] + [kind for _, kind in bridge.services]
    assert {type_name.split("/")[0] for type_name in types} <= known


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_nothing_arms_or_engages_by_itself(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    spoken = {
        name
        for now_ns in range(T0, T0 + SECOND // 2, SECOND // 50)
        for name in topics(bridge.receive_command(command(now_ns), now_ns=now_ns))
    }
    assert spoken
    assert not any("vehicle_command" in name for name in spoken)
