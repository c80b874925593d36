# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Declaring, validating, grouping and changing parameters."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    ParameterSpec,
    parameter,
    per_axis,
)


@dataclass(frozen=True, kw_only=True)
class Lamp(Configuration):
    owner = "room.lamp"

    colour: str = parameter("white", doc="Colour.", choices=("white", "red"))
    brightness: float = parameter(0.5, doc="Brightness.", minimum=0.0, maximum=1.0, live=True)


@dataclass(frozen=True, kw_only=True)
class Room(Configuration):
    owner = "room"

    name: str = parameter("hall", doc="What it is called.")
    length: float = parameter(4.0, doc="Length.", unit="m", above=0.0, below=100.0)
    doors: int = parameter(1, doc="Number of doors.", minimum=1, maximum=9)
    heated: bool = parameter(True, doc="Whether it is heated.")
    corner: tuple[float, ...] = parameter((0.0, 0.0), doc="A corner.", length=2, minimum=-5.0)
    numbers: tuple[int, ...] = parameter((1,), doc="Some numbers.")
    names: tuple[str, ...] = parameter((), doc="Names of the windows.")
    draught: float | tuple[float, ...] = parameter(0.0, doc="Draught.", minimum=0.0)
    lamp: Lamp = dataclasses.field(default_factory=Lamp)

    def check(self) -> None:
        if self.corner[0] > self.length:
            raise ConfigurationError("room.corner", self.corner, "a corner inside the room")


def refused(name: str, value: object) -> str:
    """Return the message with which a value is refused, one line that says what and why."""
    with pytest.raises(ConfigurationError) as caught:
        Room.build({name: value})
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"room.{name}: given ")
    return message


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("length", 0.0, "given 0.0, expected a number > 0 and < 100"),
        ("length", 100.0, "given 100.0, expected a number > 0 and < 100"),
        ("length", math.nan, "given nan, expected a number > 0 and < 100"),
        ("length", math.inf, "given inf, expected a number > 0 and < 100"),
        ("length", "4", "given '4', expected a number > 0 and < 100"),
        ("length", True, "given True, expected a number > 0 and < 100"),
        ("length", None, "given None, expected a number > 0 and < 100"),
        ("length", [4.0], "given [4.0], expected a number > 0 and < 100"),
        ("length", 10**400, f"given {'1' + 296 * '0'}..., expected a number > 0 and < 100"),
        ("doors", 0, "given 0, expected a whole number >= 1 and <= 9"),
        ("doors", 10, "given 10, expected a whole number >= 1 and <= 9"),
        ("doors", 2.0, "given 2.0, expected a whole number >= 1 and <= 9"),
        ("heated", 1, "given 1, expected true or false"),
        ("heated", "yes", "given 'yes', expected true or false"),
        ("name", 3, "given 3, expected text"),
        ("corner", (1.0,), "given [1.0], expected 2 numbers >= -5"),
        ("corner", (1.0, -5.1), "given [1.0, -5.1], expected 2 numbers >= -5"),
        ("corner", (1.0, "2"), "given [1.0, '2'], expected 2 numbers >= -5"),
        ("corner", "12", "given '12', expected 2 numbers >= -5"),
        ("corner", 1.0, "given 1.0, expected 2 numbers >= -5"),
        ("numbers", (1, 2.5), "given [1, 2.5], expected a list of whole numbers"),
        ("names", "abc", "given 'abc', expected a list of texts"),
        ("draught", -1.0, "given -1.0, expected a number >= 0, or 3 numbers (body x, y, z)"),
        ("draught", (1.0,), "given [1.0], expected a number >= 0, or 3 numbers (body x, y, z)"),
        (
            "draught",
            (1.0, 2.0, -3.0),
            "given [1.0, 2.0, -3.0], expected a number >= 0, or 3 numbers (body x, y, z)",
        ),
        ("draught", "123", "given '123', expected a number >= 0, or 3 numbers (body x, y, z)"),
        ("lamp.colour", "green", "given 'green', expected one of white, red"),
        ("lamp.brightness", 1.01, "given 1.01, expected a number >= 0 and <= 1"),
    ],
)
def test_a_wrong_value_is_refused_with_name_value_and_range(
    name: str, value: object, expected: str
) -> None:
    assert refused(name, value) == f"room.{name}: {expected}"


def test_accepts_an_integer_for_a_real_number() -> None:
    room = Room.build({"length": 5, "corner": [1, 2], "doors": 9, "lamp.brightness": 1})
    assert (room.length, type(room.length)) == (5.0, float)
    assert room.corner == (1.0, 2.0)
    assert [type(each) for each in room.corner] == [float, float]


@pytest.mark.parametrize(
    ("name", "suggested"),
    [
        ("lenght", "did you mean length?"),
        ("lamp.color", "did you mean lamp.colour?"),
        ("brightness", "did you mean lamp.brightness?"),
        ("zzz", "one of corner, doors, draught, heated, lamp.brightness, lamp.colour"),
    ],
)
def test_an_unknown_name_is_refused_with_a_suggestion(name: str, suggested: str) -> None:
    message = refused(name, 1)
    assert "given 1, expected a known parameter" in message
    assert suggested in message


def test_parameters_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"room\.corner: .* a corner inside the room"):
        Room(length=2.0, corner=(3.0, 0.0))
    # Neither change is possible alone, both together are.
    room = Room(length=5.0, corner=(4.0, 0.0))
    with pytest.raises(ConfigurationError):
        room.updated({"length": 1.0})
    assert room.updated({"length": 1.0, "corner": (0.5, 0.0)}).length == 1.0


def test_direct_construction_validates_as_well() -> None:
    with pytest.raises(ConfigurationError, match=r"room\.lamp\.brightness: given 2\.0"):
        Lamp(brightness=2.0)
    with pytest.raises(ConfigurationError):
        dataclasses.replace(Room(), doors=0)


rooms = st.fixed_dictionaries(
    {},
    optional={
        "name": st.text(),
        "length": st.floats(10.0, 99.0),
        "doors": st.integers(1, 9),
        "heated": st.booleans(),
        "corner": st.tuples(st.floats(-5.0, 9.0), st.floats(-5.0, 1e9)),
        "numbers": st.lists(st.integers()).map(tuple),
        "names": st.lists(st.text()).map(tuple),
        "lamp.colour": st.sampled_from(["white", "red"]),
        "lamp.brightness": st.floats(0.0, 1.0),
    },
).map(lambda values: {"length": 50.0, **values})


@settings(deadline=None, max_examples=40)
@given(rooms)
def test_flattening_and_building_are_inverse(values: dict[str, Any]) -> None:
    room = Room.build(values)
    flat = room.flattened()
    assert Room.build(flat) == room
    assert flat == {**Room().flattened(), **values}


@settings(deadline=None, max_examples=40)
@given(rooms, rooms)
def test_an_update_changes_only_the_named_parameters(
    values: dict[str, Any], changes: dict[str, Any]
) -> None:
    room = Room.build(values)
    before = room.flattened()
    assert room.updated(changes).flattened() == {**before, **changes}
    assert room.flattened() == before


def test_specs_contain_every_property_in_order() -> None:
    specs = {spec.name: spec for spec in Room.specs()}
    assert list(specs) == list(Room().flattened())
    assert specs["length"] == ParameterSpec(
        path="length", kind="double", default=4.0, doc="Length.", unit="m", above=0.0, below=100.0
    )
    assert [name for name, spec in specs.items() if spec.live] == ["lamp.brightness"]
    assert [name for name, spec in specs.items() if spec.per_axis] == ["draught"]


@pytest.mark.parametrize(
    ("given", "kept", "axes"),
    [
        (2, 2.0, (2.0, 2.0, 2.0)),
        (0.5, 0.5, (0.5, 0.5, 0.5)),
        ([1, 2.0, 0], (1.0, 2.0, 0.0), (1.0, 2.0, 0.0)),
    ],
)
def test_keeps_one_number_or_three_numbers_per_axis(
    given: Any, kept: Any, axes: tuple[float, ...]
) -> None:
    room = Room(draught=given)
    assert room.draught == kept
    assert Room.build(room.flattened()) == room
    assert per_axis(room.draught) == axes


def test_rejects_a_field_that_is_neither_parameter_nor_group() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Configuration):
        number: int = 3

    with pytest.raises(TypeError, match=r"Wrong\.number is neither a parameter nor a group"):
        Wrong.specs()
