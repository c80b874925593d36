"""The recorded parameters of a node of ours, in whatever namespace it ran."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration import Configuration


def recorded_parameters(
    parameters: Mapping[str, Mapping[str, Any]], kind: type[Configuration]
) -> dict[str, Any]:
    """Return the values of the node that ``kind`` configures; empty when none were recorded."""
    known = {spec.name for spec in kind.specs()}
    for node, values in parameters.items():
        if node.rsplit("/", 1)[-1] == kind.owner:
            # A node also has parameters of ROS itself, such as use_sim_time.
            return {name: values[name] for name in values if name in known}
    return {}
