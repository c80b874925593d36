# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A word of a parameter file, of ``--set`` or of ``-p`` is to us what it is to ROS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from fixtures.ros_context import initialised
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rclpy.node import Node

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import files, ros_yaml

LINES = (
    "5e-2 1e3 1E3 1e+3 1e7 .5 5. 5.e1 -.5 +5 -0 -0.0 +.5e-3 0 00 010 08 09.5 0x10 0X1f -0x10 0x",
    "0b11 0o17 1_000 1:30 12:30:45 2001-01-01 5e 5e+ e5 . + 1.2.3 0.1f 1,5",
    "9223372036854775807 9223372036854775808 -9223372036854775808 -9223372036854775809",
    "0x7fffffffffffffff 1e308 1e-307 0e5",
    "2.2250738585072014e-308 123456789012345678901234567890",
    ".nan .NaN .NAN nan NaN -nan .Nan +.nan .inf .Inf .INF +.inf -.inf -.INF .iNF inf -Inf",
    "INFINITY infinit",
    "y Y yes Yes YES yEs n N no No NO true True TRUE tRUE false False FALSE",
    "on On ON off Off OFF oN",
    "null Null NULL ~ = << heavy child '5' '' 'true'",
    'each "5" "y"',
)

LISTS = ["[1e7, 0.0]", "[5e-2, .5]", "[1, 0x10]", "[y, off]", "[a, '1']", "[1e3]", "[null, ~]"]


def to_ros(*arguments: str) -> Any:
    """Return the parameter ``x`` of a node that was started with these arguments."""
    with initialised(["--ros-args", *arguments]):
        node = Node(
            "mpc",
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
            enable_rosout=False,
        )
        value = node.get_parameter("x").value
        node.destroy_node()
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def alike(a: Any, b: Any) -> bool:
    """Whether two values are of the same type and the same, the sign of zeros included."""
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(alike, a, b))
    if type(a) is not type(b):
        return False
    if isinstance(a, float):
        same_sign = math.copysign(1.0, a) == math.copysign(1.0, b)
        return (math.isnan(a) and math.isnan(b)) or (a == b and same_sign)
    return bool(a == b)


def test_scalars_in_files_have_the_types_of_ros(tmp_path: Path) -> None:
    words = [*(word for line in LINES for word in line.split()), *LISTS, "!!str 5"]
    file = tmp_path / "words.yaml"
    lines = "".join(f"    word_{i}: {word}\n" for i, word in enumerate(words))
    file.write_text(f"mpc:\n  ros__parameters:\n    x: 1\n{lines}")
    with initialised(["--ros-args", "--params-file", str(file)]):
        node = Node("mpc", automatically_declare_parameters_from_overrides=True)
        (section,) = files.sections("", str(file))
        for i, word in enumerate(words):
            value = node.get_parameter(f"word_{i}").value
            listed = hasattr(value, "__len__") and not isinstance(value, str)
            expected = list(value) if listed else value
            read = section.values[f"word_{i}"]
            assert alike(read, expected), f"{word}: ROS reads {expected!r}, we {read!r}"
        node.destroy_node()


@pytest.mark.parametrize("word", ["5e-2", "1e3", ".5", "0x10", "yes", "[1e7, 0.0]", "null"])
def test_assignments_have_the_types_of_ros_overrides(word: str) -> None:
    values = files.collected([], [f"mpc.x={word}"], schema=SCHEMA)
    assert alike(values["mpc"]["x"], to_ros("-p", f"x:={word}"))


def test_names_are_always_text(tmp_path: Path) -> None:
    file = tmp_path / "names.yaml"
    file.write_text("mpc: {ros__parameters: {x: 1, y: 2, on: {1e3: 3}}}\n")
    (section,) = files.sections("", str(file))
    assert section.values == {"x": 1, "y": 2, "on.1e3": 3}


WORD = st.text(alphabet="0123456789.eExXpP+-_:nainfNAINFyYoO~", min_size=1, max_size=6)


@settings(max_examples=200)
@given(st.one_of(WORD, st.floats().map(repr), st.integers().map(str)))
@example("1e3")
@example("y")
@example("null")
def test_written_yaml_is_read_back_by_every_reader(text: str) -> None:
    """PyYAML, which launch files and ``ros2 param`` use, included."""
    written = ros_yaml.written({"text": text})
    assert ros_yaml.read(written)["text"] == text
    assert yaml.safe_load(written)["text"] == text


@pytest.mark.parametrize("text", ["{a: 1, a: 2}", "{a: {b: 1}, 'a': {c: 2}}"])
def test_a_name_that_is_given_twice_is_refused(text: str) -> None:
    with pytest.raises(yaml.YAMLError, match="'a' is given twice"):
        ros_yaml.read(text)
