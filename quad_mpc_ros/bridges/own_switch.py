"""For stacks without a mode of their own: the bridge itself is switched on and off."""

from __future__ import annotations

from quad_mpc_ros.bridges.bridge import Answer, Bridge


class SwitchedBridge(Bridge):
    """Says nothing until its service ``engage`` was asked."""

    _engaged = False

    def engage(self, wanted: bool, *, now_ns: int) -> Answer:
        """Let commands through, or no longer."""
        self._engaged = wanted
        return Answer(accepted=True, text="engaged" if wanted else "released")

    def _reason_for_silence(self, now_ns: int) -> str | None:
        return None if self._engaged else "not engaged: call the service engage"
