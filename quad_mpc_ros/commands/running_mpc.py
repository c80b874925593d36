"""A running MPC node, looked at from outside: its parameters, the figures of its ticks."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any, Self

from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

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
        self._ticks: list[TickStats] = []
        self._foreign = 0

    def __enter__(self) -> Self:
        super().__enter__()
        self._parameters = AsyncParameterClient(self.node, self.name)
        return self

    def configuration(self) -> MpcConfig:
        """Return what the node flies with. Raises :class:`UserError` when it does not answer."""
        names = [spec.name for spec in MpcConfig.specs()]
        deadline = time.monotonic() + _ANSWER_TIMEOUT
        if self._spin(self._parameters.services_are_ready, deadline):
            answer = self._parameters.get_parameters(names)
            if self._spin(answer.done, deadline):
                return self._built(names, answer.result().values)
        raise UserError(
            f"--node: no node {self.name} answers within {_ANSWER_TIMEOUT:g} s; expected the full "
            "name of a running mpc_node, in the same ROS_DOMAIN_ID"
        )

    def watch(self, duration: float) -> list[TickStats]:
        """Return the figures of the ticks of the next ``duration`` seconds, from the first on."""
        namespace = self.name.rpartition("/")[0]
        topic = dataclasses.replace(STATS, name=f"{namespace}/{STATS.name}")
        subscribe(self.node, topic, self._on_stats)
        self._spin(lambda: bool(self._ticks), time.monotonic() + _ANSWER_TIMEOUT)
        self._spin(lambda: False, time.monotonic() + duration)
        if self._foreign and not self._ticks:
            raise UserError(
                f"{topic.name}: {self._foreign} messages, none with the figures of a tick"
            )
        return self._ticks

    def _built(self, names: list[str], values: list[Any]) -> MpcConfig:
        known = {
            name: value if isinstance(value, bool | int | float | str) else list(value)
            for name, value in zip(names, map(parameter_value_to_python, values), strict=False)
            if value is not None
        }
        if not known:
            raise UserError(f"--node: {self.name} has no parameters of an mpc_node")
        return MpcConfig.build(known)

    def _on_stats(self, message: Any) -> None:
        try:
            self._ticks.append(tick_stats(message))
        except (KeyError, ValueError):
            self._foreign += 1

    def _spin(self, until: Callable[[], bool], deadline: float) -> bool:
        while not until():
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return False
            self.executor.spin_once(timeout_sec=min(remaining, 0.1))
        return True
