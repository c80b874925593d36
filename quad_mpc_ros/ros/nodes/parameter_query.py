# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Query of all parameters of another node, without blocking."""

from __future__ import annotations

import time
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

# A response is lost if the other node has not discovered this one yet.
_RETRY_PERIOD = 2.0  # s


class ParameterQuery:
    """One query; its clients exist only while it runs, because each costs time per wake-up."""

    def __init__(self, node: Node, node_name: str) -> None:
        self.node_name = node_name
        self.done = False
        self._node = node
        namespace = node.get_namespace().rstrip("/")
        self._full_name = node_name if node_name.startswith("/") else f"{namespace}/{node_name}"
        self._clients: list[Any] = []
        self._names: Any = None
        self._values: Any = None
        self._called_s = 0.0

    def poll(self) -> dict[str, Any] | None:
        """Advance the query; return the parameters once, when they have arrived."""
        if self.done or not self._ready():
            return None
        list_names, get_values = self._clients
        if self._names is None:
            self._names = self._call(list_names, ListParameters.Request())
        elif self._values is None and self._names.done():
            names = self._names.result().result.names
            self._values = self._call(get_values, GetParameters.Request(names=names))
        elif self._values is not None and self._values.done():
            self.done = True
            self.close()
            return self._received()
        elif time.monotonic() - self._called_s > _RETRY_PERIOD:
            self._names = self._values = None
        return None

    def _call(self, client: Any, request: Any) -> Any:
        self._called_s = time.monotonic()
        return client.call_async(request)

    def close(self) -> None:
        """End the query."""
        for client in self._clients:
            self._node.destroy_client(client)
        self._clients = []

    def _ready(self) -> bool:
        if not self._clients:
            nodes = self._node.get_node_names_and_namespaces()
            if self._full_name not in (f"{space.rstrip('/')}/{name}" for name, space in nodes):
                return False
            self._clients = [
                self._node.create_client(ListParameters, f"{self._full_name}/list_parameters"),
                self._node.create_client(GetParameters, f"{self._full_name}/get_parameters"),
            ]
        return all(client.service_is_ready() for client in self._clients)

    def _received(self) -> dict[str, Any]:
        names = self._names.result().result.names
        values = (parameter_value_to_python(value) for value in self._values.result().values)
        return {
            name: value if isinstance(value, bool | int | float | str) else list(value)
            for name, value in zip(names, values, strict=True)
            if value is not None
        }
