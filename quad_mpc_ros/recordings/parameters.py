# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the nodes of a run, stored in its bag: one MCAP metadata record per node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import yaml

from quad_mpc_ros.configuration import BagError, Configuration, files, ros_yaml

if TYPE_CHECKING:  # a simulated flight needs no bag
    from quad_mpc_ros.recordings.writer import BagWriter

_PREFIX = "parameters:"
_KEY = "yaml"


def write_parameters(writer: BagWriter, node: str, values: Mapping[str, Any]) -> None:
    """Store the parameters of a node, by dotted name, as a ROS parameter file."""
    writer.write_metadata(f"{_PREFIX}{node}", {_KEY: files.dump(node, values)})


def read_parameters(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, Any]]:
    """Return the parameters in the metadata of a bag by node name and dotted parameter name.

    Raises :class:`BagError` for a record that is not a ROS parameter file.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, record in metadata.items():
        if name.startswith(_PREFIX) and _KEY in record:
            try:
                for node, content in ros_yaml.read(record[_KEY]).items():
                    found[node] = dict(content["ros__parameters"])
            except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
                raise BagError(f"metadata record {name} is not a ROS parameter file") from error
    return found


def recorded_parameters(
    parameters: Mapping[str, Mapping[str, Any]], kind: type[Configuration]
) -> dict[str, Any]:
    """Return the parameters of the node that ``kind`` configures, in any namespace.

    Empty if no parameters were recorded. ``parameters`` are the recorded parameters by node.
    """
    known = {spec.name for spec in kind.specs()}
    for node, values in parameters.items():
        if node.rsplit("/", 1)[-1] == kind.owner:
            # A node also has parameters of ROS itself, such as use_sim_time.
            return {name: value for name, value in values.items() if name in known}
    return {}
