"""Whether the estimate still describes the vehicle; one that does not is reset."""

from __future__ import annotations

from quad_mpc_ros.control.lie import formulas

_SECOND = 1_000_000_000
_AT_BOUNDS_NS = 3 * _SECOND
# A reset that did not help is not repeated at once: the estimate jumps with each.
_PATIENCE_NS = 30 * _SECOND
_FORGETTING = 1.0  # s, of the share of odometries that were refused
_MOST_REFUSED = 0.5
_REPORTED_NS = 10 * _SECOND


class EstimateHealth:
    """Counts how long the estimate has been at its bounds, or refuses what is measured."""

    def __init__(self) -> None:
        self.resets = 0
        """How often the estimate was reset."""
        self._refused = 0.0
        self._bounds_since_ns: int | None = None
        self._reset_ns: int | None = None

    def fails(self, now_ns: int, *, duration: float, refused: bool, at_bounds: bool) -> bool:
        """Take an odometry that could update the estimate; return whether to reset it.

        ``duration`` [s] is since the one before. Call it once for each: a reset is counted.
        """
        share = formulas.lowpass_share(duration, _FORGETTING)
        self._refused += share * ((1.0 if refused else 0.0) - self._refused)
        if not at_bounds:
            self._bounds_since_ns = None
        elif self._bounds_since_ns is None:
            self._bounds_since_ns = now_ns
        stuck = (
            self._bounds_since_ns is not None and now_ns - self._bounds_since_ns > _AT_BOUNDS_NS
        )
        tried = self._reset_ns is not None and 0 <= now_ns - self._reset_ns < _PATIENCE_NS
        if tried or not (stuck or self._refused > _MOST_REFUSED):
            return False
        self.resets += 1
        self._reset_ns, self._bounds_since_ns, self._refused = now_ns, None, 0.0
        return True

    def was_reset(self, now_ns: int) -> bool:
        """Whether a reset is recent enough to be reported."""
        return self._reset_ns is not None and 0 <= now_ns - self._reset_ns < _REPORTED_NS
