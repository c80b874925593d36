# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An alarm of a managed node comes when its callback said, and no more often."""

from __future__ import annotations

import time

import pytest
from fixtures.ros_context import initialised
from rclpy.task import Future

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.messages.diagnostics import OK
from quad_mpc_ros.ros.health import Health
from quad_mpc_ros.ros.lifecycle import ManagedNode
from quad_mpc_ros.ros.spin import fastest_executor

PAUSES = [0.3, 0.02, 0.02, 0.3, 0.02, 0.02]


class _Woken(ManagedNode[MpcConfig]):
    def __init__(self) -> None:
        super().__init__("woken", MpcConfig)
        self.times: list[float] = []
        self.start()

    def configure(self, config: MpcConfig) -> None:
        self.managed_timer(0.05, self._on_alarm)

    def report(self) -> Health:
        return Health(level=OK, text="awake")

    def _on_alarm(self) -> float:
        self.times.append(time.monotonic())
        return PAUSES[len(self.times) % len(PAUSES) - 1]


def test_alarm_follows_period_of_its_callback() -> None:
    with initialised():
        node = _Woken()
        executor = fastest_executor(message_info=False)
        executor.add_node(node)
        deadline = time.monotonic() + 30.0
        while len(node.times) < 2 * len(PAUSES) and time.monotonic() < deadline:
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)
        node.destroy_node()
    passed = [after - before for before, after in zip(node.times, node.times[1:], strict=False)]
    expected = (2 * PAUSES)[: len(passed)]
    assert len(passed) >= 2 * len(PAUSES) - 1
    # Never early; how late is the machine's business.
    assert all(took > pause - 0.005 for took, pause in zip(passed, expected, strict=True))
    assert min(passed) < 0.3


class _Hindered(ManagedNode[MpcConfig]):
    """What is in the way of its activation is read twice, and comes and goes."""

    def __init__(self, obstacles: list[str | None]) -> None:
        super().__init__("hindered", MpcConfig)
        self._obstacles = obstacles
        self.start()

    def activation_blocker(self) -> str | None:
        return self._obstacles.pop(0) if self._obstacles else None

    def report(self) -> Health:
        return Health(level=OK, text="active")


@pytest.mark.parametrize("refused", [1, 2, 5])
def test_retries_a_refused_automatic_activation(refused: int) -> None:
    with initialised():
        node = _Hindered([each for _ in range(refused) for each in (None, "too old")])
        for _ in range(refused):
            assert node._activates_by_itself() is False
        assert node._activates_by_itself() is True
        assert node.active
        node.destroy_node()
