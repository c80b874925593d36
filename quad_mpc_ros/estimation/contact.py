"""Does the vehicle stand on the ground?"""

from __future__ import annotations

_REST_SPEED = 0.1  # m/s
# Shares of its weight: less cannot keep it at rest in the air, more may have lifted it.
_TOO_LITTLE, _ENOUGH = 0.6, 0.95
# With too little it would be faster than rest within a tenth of this.
_DWELL_NS = 300_000_000


class GroundContact:
    """Judges by rest and lift: ``standing`` once some time has shown that it cannot be flying."""

    def __init__(self) -> None:
        self.standing = False
        self._too_little, self._enough = _Lasting(), _Lasting()

    def update(self, *, speed: float, lift: float, now_ns: int) -> bool:
        """Return whether it stands, from its speed [m/s] and its lift as a share of its weight."""
        resting = speed < _REST_SPEED
        grounded = self._too_little.update(resting and lift <= _TOO_LITTLE, now_ns=now_ns)
        lifted = self._enough.update(lift > _ENOUGH, now_ns=now_ns)
        if grounded:
            self.standing = True
        elif lifted or not resting:
            self.standing = False
        return self.standing


class _Lasting:
    """Whether something has been true for longer than the dwell time."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def update(self, true: bool, *, now_ns: int) -> bool:
        if not true:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns > _DWELL_NS
