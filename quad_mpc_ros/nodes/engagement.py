"""Whether the vehicle acts on the commands of the MPC, as a bridge says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.impl.rcutils_logger import RcutilsLogger


class Engagement:
    """Takes what is said on ``engaged``; where nobody says it the vehicle is supposed to act."""

    def __init__(self, logger: RcutilsLogger, engage: Callable[[bool], None]) -> None:
        self._logger, self._engage = logger, engage
        self._engaged: bool | None = None

    @property
    def told(self) -> str:
        """What was said last: true, false, or not told."""
        return "not told" if self._engaged is None else str(self._engaged).lower()

    def on_message(self, message: Any) -> None:
        """Pass it on, and log it when it is new."""
        engaged = bool(message.data)
        self._engage(engaged)
        if engaged is not self._engaged:
            self._engaged = engaged
            self._logger.info(
                "commands act" if engaged else "commands do not act: nothing is learned of them"
            )

    def repeat(self) -> None:
        """Tell a new controller what was said last."""
        if self._engaged is not None:
            self._engage(self._engaged)
