"""Does the vehicle stand on the ground?"""

from __future__ import annotations

_REST_SPEED = 0.1  # m/s
# Shares of its weight: less cannot keep it at rest in the air, more lifts it.
_TOO_LITTLE, _ENOUGH = 0.6, 0.95
# With so little it would be faster than rest within a tenth of this.
_DWELL_NS = 300_000_000


class GroundContact:
    """Judges by rest and lift: flying, until some time shows that it cannot be."""

    def __init__(self) -> None:
        self._standing = False
        self._resting_since_ns: int | None = None

    def update(self, *, speed: float, lift: float, now_ns: int) -> bool:
        """Return whether it stands, from its speed [m/s] and its lift as a share of its weight."""
        resting = speed < _REST_SPEED
        if not resting or lift > _ENOUGH:
            self._standing = False
        if not resting or lift > _TOO_LITTLE:
            self._resting_since_ns = None
        elif self._resting_since_ns is None:
            self._resting_since_ns = now_ns
        elif now_ns - self._resting_since_ns > _DWELL_NS:
            self._standing = True
        return self._standing
