"""A command's own small node, spun from its main thread beside the nodes that fly."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions


class Observer:
    """Base of what watches a flight: ``node`` and ``executor`` exist inside of ``with``.

    Ctrl-C stays Python's own, for the command to end the nodes in order.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> Self:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(self._name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        return self

    def __exit__(
        self,
        _: type[BaseException] | None,
        __: BaseException | None,
        ___: TracebackType | None,
    ) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()
