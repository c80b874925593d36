# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Throttled warnings: logged at once, then every few seconds."""

from __future__ import annotations

import re
import time

from rclpy.node import Node

_REPEAT_PERIOD = 5.0  # s
_VARYING_TEXT = re.compile(r"'[^']*'|[\d.]+")


class RepeatedWarnings:
    """Logs a text, unless a text that differs only in numbers and names was logged recently."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._logged: dict[str, float] = {}

    def warn(self, text: str) -> None:
        """Log the text, if it is due."""
        now, kind = time.monotonic(), _VARYING_TEXT.sub("", text)
        self._logged = {each: at for each, at in self._logged.items() if now - at < _REPEAT_PERIOD}
        if kind not in self._logged:
            self._logged[kind] = now
            self._node.get_logger().warning(text)
