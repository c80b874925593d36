"""Parameter files that are written for nodes."""

from __future__ import annotations

import yaml

from quad_mpc_ros.configuration import files


def test_empty_list_is_left_to_the_default() -> None:
    """With an empty list in a file, rclpy does not start the node, because it has no type."""
    text = files.dump("mpc", {"gates": (), "Q": (1.0, 2.0), "name": ""})
    assert yaml.safe_load(text) == {"mpc": {"ros__parameters": {"Q": [1.0, 2.0], "name": ""}}}
