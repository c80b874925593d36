# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Battery voltages in recordings."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from fixtures.stack_messages import DEFINITIONS

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.cdr import written_battery
from quad_mpc_ros.messages.topics import BATTERY, COMMAND
from quad_mpc_ros.recordings.recording import VOLTAGE_FIELDS, Recording


@pytest.fixture
def bag(make_bag: Callable[..., Any], build: SimpleNamespace) -> Any:
    """Return a bag with two odometries, to which batteries are added."""
    made = make_bag()
    for k in range(2):
        made.odometry(build.odometry(build.start_ns + k * build.period_ns))
    return made


def write_voltages(bag: Any, topic: str, *volts: float, start_ns: int) -> None:
    for k, voltage in enumerate(volts):
        data = written_battery(voltage, stamp_ns=start_ns + k)
        bag.write(topic, BATTERY.type_name, data, start_ns + k)


def volts(bag: Any, topic: str = "") -> list[tuple[int, float]]:
    bag.writer.close()
    names = {BATTERY: topic} if topic else {}
    run = Recording(bag.writer.directory).run(names, topics=(COMMAND, BATTERY))
    return [(sample.log_time_ns, sample.value) for sample in run.voltages]


def test_finds_the_only_battery_by_type(bag: Any, build: SimpleNamespace) -> None:
    start = build.start_ns
    write_voltages(bag, "/uav1/pack/left", 16.5, 16.25, start_ns=start)
    assert volts(bag) == [(start, 16.5), (start + 1, 16.25)]


def test_no_battery_gives_no_voltages(bag: Any) -> None:
    assert volts(bag) == []


def test_two_batteries_need_a_name(bag: Any, build: SimpleNamespace) -> None:
    write_voltages(bag, "/pack", 16.0, start_ns=build.start_ns)
    write_voltages(bag, "/spare/pack", 15.0, start_ns=build.start_ns)
    assert volts(bag, "pack") == [(build.start_ns, 16.0)]
    reread = Recording(bag.writer.directory)
    with pytest.raises(BagError, match="/pack, /spare/pack all report a battery: select the"):
        reread.run(topics=(BATTERY,))
    assert not reread.run(topics=(COMMAND,)).voltages  # not requested


@pytest.mark.parametrize("kind", sorted(VOLTAGE_FIELDS.keys() & DEFINITIONS.keys()))
def test_voltage_fields_exist_in_the_stacks_definitions(kind: str) -> None:
    assert f"{VOLTAGE_FIELDS[kind]}\n" in f"{DEFINITIONS[kind]}\n"
