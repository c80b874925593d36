"""Which topics a recorder or a player takes."""

from __future__ import annotations

import pytest

from quad_mpc_ros.configuration import Configuration, ConfigurationError
from quad_mpc_ros.recordings.config import RecorderConfig, TopicSelection

THERE = ("/odom", "/uav1/odom", "/uav1/mpc/stats", "/rosout", "/uav1/_internal", "/_hidden")


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        (TopicSelection(names=["/odom", "/gone"]), {"/odom"}),
        (TopicSelection(pattern="odom"), {"/odom", "/uav1/odom"}),
        (TopicSelection(pattern="^/odom$"), {"/odom"}),
        (TopicSelection(names=["/rosout"], pattern="stats$"), {"/rosout", "/uav1/mpc/stats"}),
        (TopicSelection(everything=True), {"/odom", "/uav1/odom", "/uav1/mpc/stats", "/rosout"}),
        (TopicSelection(everything=True, exclude="^/uav1"), {"/odom", "/rosout"}),
        (TopicSelection(names=["/odom"], exclude="odom"), set()),
        (TopicSelection(names=["/_hidden"], pattern="internal"), {"/_hidden"}),
        (TopicSelection(), set()),
    ],
)
def test_topic_selection(selection: TopicSelection, expected: set[str]) -> None:
    assert {topic for topic in THERE if selection.includes(topic)} == expected


@pytest.mark.parametrize(
    ("config", "name"),
    [
        (RecorderConfig, "topics_regex"),
        (RecorderConfig, "topics_exclude_regex"),
    ],
)
def test_refuses_an_invalid_regular_expression(config: type[Configuration], name: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"{name}: given '\(', expected a regular"):
        config.build({name: "("})
