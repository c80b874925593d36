"""A running MPC node, looked at from outside: its parameters, the figures of its ticks."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

from quad_mpc_ros.commands.observer import Observer, subscribe
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.messages.topics import STATS
from quad_mpc_ros.recordings.logs import tick_stats

_ANSWER_TIMEOUT = 5.0  # s, discovery included


class RunningMpc(Observer):
    """A small node beside the MPC node ``name``, a full name like ``/uav1/mpc``."""

    def __init__(self, name: str) -> None:
        super().__init__("quad_mpc_save_vehicle")
        self.name = f"/{name.strip('/')}"
        self._namespace = self.name.rpartition("/")[0]
        self._ticks: list[TickStats] = []
        self._foreign = 0

    def configuration(self) -> MpcConfig:
        """Return what the node flies with. Raises :class:`UserError` when it does not answer."""
        parameters = self._parameters(self.name)
        if parameters is None:
            raise UserError(
                f"--node: no node {self.name} answers within {_ANSWER_TIMEOUT:g} s; expected the "
                "full name of a running mpc_node, in the same ROS_DOMAIN_ID"
            )
        names = [spec.name for spec in MpcConfig.specs() if spec.name in parameters]
        if not names:
            raise UserError(f"--node: {self.name} has no parameters of an mpc_node")
        return MpcConfig.build({name: parameters[name] for name in names})

    def bridge(self) -> dict[str, Any]:
        """Return the thrust map of the bridge in the same namespace; empty without one."""
        for name, place in self.node.get_node_names_and_namespaces():
            if name.endswith("_bridge") and place.rstrip("/") == self._namespace:
                parameters = self._parameters(f"{self._namespace}/{name}") or {}
                return {name: value for name, value in parameters.items() if "thrust_map" in name}
        return {}

    def watch(self, duration: float) -> list[TickStats]:
        """Return the figures of the ticks of the next ``duration`` seconds, from the first on."""
        topic = dataclasses.replace(STATS, name=f"{self._namespace}/{STATS.name}")
        subscribe(self.node, topic, self._on_stats)
        self.spin_until(lambda: bool(self._ticks), time.monotonic() + _ANSWER_TIMEOUT)
        self.spin_until(lambda: False, time.monotonic() + duration)
        if self._foreign and not self._ticks:
            raise UserError(
                f"{topic.name}: {self._foreign} messages, none with the figures of a tick"
            )
        return self._ticks

    def _parameters(self, node: str) -> dict[str, Any] | None:
        """Return the parameters of a node; None if it does not answer."""
        return self.parameters([node], time.monotonic() + _ANSWER_TIMEOUT).get(node)

    def _on_stats(self, message: Any) -> None:
        try:
            self._ticks.append(tick_stats(message))
        except (KeyError, ValueError):
            self._foreign += 1
