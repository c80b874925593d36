"""The parameters of a run, kept in its bag: one MCAP metadata record per node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from quad_mpc_ros.bags.reader import BagReader
from quad_mpc_ros.bags.writer import BagWriter
from quad_mpc_ros.configuration import files

_PREFIX = "parameters:"
_KEY = "yaml"


def write_parameters(writer: BagWriter, node: str, values: Mapping[str, Any]) -> None:
    """Store the parameters of a node, by dotted name, as a ROS parameter file."""
    writer.write_metadata(f"{_PREFIX}{node}", {_KEY: files.dump(node, values)})


def read_parameters(reader: BagReader) -> dict[str, dict[str, Any]]:
    """Return the parameters stored in a bag by node name and dotted parameter name."""
    found: dict[str, dict[str, Any]] = {}
    for name, record in reader.metadata.items():
        if name.startswith(_PREFIX) and _KEY in record:
            for node, content in yaml.safe_load(record[_KEY]).items():
                found[node] = content["ros__parameters"]
    return found
