"""The parameters of a run, kept in its bag: one MCAP metadata record per node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from quad_mpc_ros.configuration import files
from quad_mpc_ros.messages.errors import BagError
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter

_PREFIX = "parameters:"
_KEY = "yaml"


def write_parameters(writer: BagWriter, node: str, values: Mapping[str, Any]) -> None:
    """Store the parameters of a node, by dotted name, as a ROS parameter file."""
    writer.write_metadata(f"{_PREFIX}{node}", {_KEY: files.dump(node, values)})


def read_parameters(reader: BagReader) -> dict[str, dict[str, Any]]:
    """Return the parameters stored in a bag by node name and dotted parameter name.

    Raises :class:`BagError` for a record that is no ROS parameter file.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, record in reader.metadata.items():
        if name.startswith(_PREFIX) and _KEY in record:
            try:
                for node, content in yaml.safe_load(record[_KEY]).items():
                    found[node] = dict(content["ros__parameters"])
            except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
                raise BagError(f"metadata record {name} is no ROS parameter file") from error
    return found
