# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The files for viewers name topics and fields that exist, with the quality that is offered."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from quad_mpc_ros.commands.params import own_nodes
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages import topics
from quad_mpc_ros.messages.diagnostics import STATS_NAME
from quad_mpc_ros.ros.bridges.registry import bridge_configurations

VIEWERS = Path(__file__).parents[2] / "config" / "viewers"
STORE = get_typestore(Stores.ROS2_JAZZY)
TOPICS = {
    f"/{topic.name.lstrip('/')}": topic
    for topic in vars(topics).values()
    if isinstance(topic, topics.Topic)
}
STATS_KEYS = {field.name for field in fields(TickStats)}
FOXGLOVE: dict[str, Any] = json.loads((VIEWERS / "foxglove.json").read_text())
RVIZ: dict[str, Any] = yaml.safe_load((VIEWERS / "quad_mpc.rviz").read_text())
PLOTJUGGLER = ElementTree.parse(VIEWERS / "plotjuggler.xml").getroot()

FOXGLOVE_PATHS = [
    path["value"] for panel in FOXGLOVE["configById"].values() for path in panel.get("paths", [])
]
CURVES = [str(curve.get("name")) for curve in PLOTJUGGLER.iter("curve")]
# Made by PlotJuggler out of a quaternion.
ANGLES = {"roll", "pitch", "yaw"}


def kind_of(type_name: str, steps: list[str]) -> str:
    """Return the type that a way through the fields of a message leads to."""
    for step in steps:
        node, content = dict(STORE.fielddefs[type_name][1])[step]
        while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, content = content[0]
        type_name = content if node == Nodetype.NAME else content[0]
    return type_name


def topic_in(address: str, separator: str) -> tuple[topics.Topic, str]:
    """Return the topic that an address begins with, and the rest of it."""
    (name,) = [name for name in TOPICS if address.startswith(name + separator)]
    return TOPICS[name], address[len(name) + 1 :]


@pytest.mark.parametrize("path", FOXGLOVE_PATHS)
def test_foxglove_paths_resolve(path: str) -> None:
    topic, rest = topic_in(path, ".")
    key = re.search(r'\{key=="(\w+)"\}', rest)
    if key:
        assert key[1] in STATS_KEYS
    steps = re.sub(r"\{.*?\}|\[.*?\]", "", rest).split(".")
    assert kind_of(topic.type_name, steps) == ("string" if key else "float64")


@pytest.mark.parametrize("curve", CURVES)
def test_plotjuggler_curves_resolve(curve: str) -> None:
    topic, rest = topic_in(curve, "/")
    if topic is topics.STATS:
        # PlotJuggler names them by the status and the key.
        status, key = rest.split("/")
        assert status == STATS_NAME
        assert key in STATS_KEYS
        return
    steps = re.sub(r"\[\d+\]", "", rest).split("/")
    if steps[-1] in ANGLES:
        steps[-1] = "w"
    assert kind_of(topic.type_name, steps) == "float64"


def test_rviz_displays_match_the_offered_topics() -> None:
    classes = {"MarkerArray": "MarkerArray", "Path": "Path", "Odometry": "Odometry"}
    displays = [each for each in RVIZ["Visualization Manager"]["Displays"] if "Topic" in each]
    assert len(displays) == 4
    for display in displays:
        asked = display["Topic"]
        topic = TOPICS[asked["Value"]]
        kind = display["Class"].rpartition("/")[2]
        assert topic.type_name.rpartition("/")[2] == classes[kind]
        # A subscription may not ask for more than is offered, and needs what is latched.
        assert asked["Reliability Policy"] == ("Reliable" if topic.reliable else "Best Effort")
        assert (asked["Durability Policy"] == "Transient Local") == topic.latched


def test_rviz_sends_goals_where_the_reference_node_listens() -> None:
    (tool,) = (each for each in RVIZ["Visualization Manager"]["Tools"] if "Topic" in each)
    assert tool["Class"] == "rviz_default_plugins/SetGoal"
    assert TOPICS[tool["Topic"]["Value"]] is topics.GOAL_POSE
    assert tool["Topic"]["Reliability Policy"] == "Reliable"  # as the subscription wants it


@pytest.mark.parametrize("namespace", ["", "/uav1"])
def test_each_node_belongs_to_one_group_of_the_aggregator(namespace: str) -> None:
    file = yaml.safe_load((VIEWERS / "diagnostic_aggregator.yaml").read_text())
    groups = [
        each for each in file["analyzers"]["ros__parameters"].values() if each != "Quadrotor"
    ]
    for node in (*own_nodes(), *bridge_configurations()):
        name = f"{namespace}/{node}"
        assert [any(part in name for part in each["contains"]) for each in groups].count(True) == 1
