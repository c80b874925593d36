# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The query of a node's parameters, of a node whose first answers are lost."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.msg import ListParametersResult
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import Parameter
from rclpy.task import Future

from quad_mpc_ros.ros.nodes import parameter_query
from quad_mpc_ros.ros.nodes.parameter_query import ParameterQuery

ANSWERS = {
    ListParameters: ListParameters.Response(result=ListParametersResult(names=["mass"])),
    GetParameters: GetParameters.Response(
        values=[Parameter("mass", value=1.5).get_parameter_value()]
    ),
}


class Client:
    """Answers at once, but for the first request, whose answer is lost."""

    def __init__(self, kind: Any) -> None:
        self._kind, self.requests = kind, 0

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, _request: Any) -> Any:
        self.requests += 1
        answer: Any = Future()
        if self.requests > 1:
            answer.set_result(ANSWERS[self._kind])
        return answer


class Asking:
    """What the query needs of a node."""

    def __init__(self) -> None:
        self.clients: list[Client] = []

    def get_namespace(self) -> str:
        return "/uav1"

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [("mpc", "/uav1")]

    def create_client(self, kind: Any, _name: str) -> Client:
        self.clients.append(Client(kind))
        return self.clients[-1]

    def destroy_client(self, client: Client) -> None:
        self.clients.remove(client)


def test_repeats_unanswered_query(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(parameter_query.time, "monotonic", lambda: now)
    node: Any = Asking()
    query = ParameterQuery(node, "mpc")
    found = None
    while found is None and now < 20.0:
        found = query.poll()
        now += 0.1
    assert found == {"mass": 1.5}
    assert query.done and not node.clients
