# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Schemas against the installed packages, rosidl's own parser, and rosbag2's test vector."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.messages import RECORDED_TYPES
from rosbags.typesys import get_types_from_msg
from rosidl_adapter.parser import parse_message_string

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.messages.schemas import schema_for

SHARE = Path(sys.prefix) / "share"
SEPARATOR = "\n" + "=" * 80 + "\nMSG: "


def expected_sections(reference: str, seen: list[str]) -> list[tuple[str, str]]:
    """Return names and texts in rosbag2's order, the fields as rosidl's parser sees them."""
    package, name = reference.split("/")
    text = (SHARE / package / "msg" / f"{name}.msg").read_bytes().decode()
    sections = [(reference, text)]
    fields = parse_message_string(package, name, text).fields
    used = {f"{f.type.pkg_name}/{f.type.type}" for f in fields if f.type.pkg_name}
    for dependency in sorted(used):
        if dependency not in seen:
            seen.append(dependency)
            sections += expected_sections(dependency, seen)
    return sections


@pytest.mark.parametrize("type_name", RECORDED_TYPES)
def test_text_is_what_rosbag2_writes_of_the_installed_files(type_name: str) -> None:
    (_, root), *used = expected_sections(type_name.replace("/msg/", "/"), [])
    expected = root + "".join(f"{SEPARATOR}{name}\n{text}" for name, text in used)
    assert schema_for(type_name).text == expected


@pytest.mark.parametrize("type_name", RECORDED_TYPES)
def test_without_ros_a_type_has_the_installed_fields_constants_and_hash(
    type_name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = schema_for(type_name)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    monkeypatch.setattr(sys, "prefix", "/nowhere")
    generated = schema_for(type_name)
    assert generated.text != installed.text  # comments
    definitions = get_types_from_msg(installed.text, type_name)
    assert get_types_from_msg(generated.text, type_name) == definitions
    assert generated.type_hash == installed.type_hash


def install(prefix: Path, reference: str, text: str) -> None:
    package, name = reference.split("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.msg").write_text(text)
    hashes = [{"type_name": f"{package}/msg/{name}", "hash_string": f"RIHS01_{name}"}]
    (folder / f"{name}.json").write_text(json.dumps({"type_hashes": hashes}))


def test_each_dependency_once_depth_first_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "p/Root", "Zed[<=3] z\nstring<=4 s\nuint8 A=1\nb/Alpha[2] a # Ghost g\n")
    install(tmp_path, "p/Zed", "b/Alpha a")
    install(tmp_path, "b/Alpha", "Beta b\n")
    install(tmp_path, "b/Beta", "int8 x\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    sections = schema_for("p/msg/Root").text.split(SEPARATOR)
    assert [section.partition("\n")[0] for section in sections[1:]] == [
        "b/Alpha",
        "b/Beta",
        "p/Zed",
    ]
    assert sections[-1] == "p/Zed\nb/Alpha a"


def test_missing_type_names_the_places_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(BagError) as caught:
        schema_for("px4_msgs/msg/VehicleOdometry")
    message = str(caught.value)
    assert "share/px4_msgs/msg/VehicleOdometry.msg" in message
    assert str(tmp_path) in message
    assert sys.prefix in message
    assert "\n" not in message


@pytest.mark.parametrize("name", ["Odometry", "nav_msgs/Odometry", "a/srv/B", "../../x", ""])
def test_rejects_invalid_message_type_names(name: str) -> None:
    with pytest.raises(BagError, match="expected pkg/msg/Type"):
        schema_for(name)


WITHOUT_ROS = """
import sys
sys.prefix = "/nowhere"
from pathlib import Path
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter
with BagWriter(Path(sys.argv[1])) as writer:
    for type_name in sys.argv[2:]:
        writer.add_topic("/" + type_name, type_name)
assert len(BagReader(Path(sys.argv[1])).topics) == len(sys.argv[2:])
packages = {name.partition(".")[0] for name in sys.modules}
loaded = [name for name in packages if name.endswith(("rclpy", "_msgs", "_interfaces"))]
assert not loaded, loaded
"""


def test_needs_no_ros(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    environment.pop("AMENT_PREFIX_PATH", None)
    subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS, str(tmp_path / "bag"), *RECORDED_TYPES],
        check=True,
        env=environment,
    )
