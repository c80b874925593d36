"""What the controller intends to fly: the inputs it has chosen, and where they lead."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import Input


class Plan(NamedTuple):
    """The trajectory the controller intends to fly, starting at ``stamp_ns``.

    ``inputs`` (K, 4): throttle and body rates held over ``input_step`` seconds each. ``p_WB``
    (N + 1, 3) [m] and ``R_WB`` (N + 1, 3, 3): the predicted poses every ``step`` seconds, the
    first is now. ``speeds`` (N,) are how fast the reference's time passes in each of these steps,
    none (0,) where it passes as on a clock.
    """

    stamp_ns: int
    step: float
    input_step: float
    inputs: Array
    p_WB: Array
    R_WB: Array
    speeds: Array = np.ones(0)

    def given_up(self, since: float, until: float) -> float:
        """Return by how much the reference's time falls behind the clock between two times [s].

        They are counted from the beginning of the plan; beyond its end nothing is given up.
        """
        ends = self.step * np.arange(1, len(self.speeds) + 1)
        spent = np.clip(np.minimum(until, ends) - np.maximum(since, ends - self.step), 0.0, None)
        return float(spent @ (1.0 - self.speeds))

    def command_over(self, elapsed: float, duration: float) -> Input:
        """Return the mean of the inputs planned for a time ``elapsed`` seconds on.

        The last one is held beyond the end.
        """
        begin = max(elapsed, 0.0) / self.input_step
        throttle, *rates = _mean_over(self.inputs, begin, begin + duration / self.input_step)
        return Input(throttle=throttle, w_WB_B=np.array(rates))


# 0.15 / 0.05 is a little less than 3.
_ROUNDING = 1e-9


@compiled
def _mean_over(inputs: Array, begin: float, end: float) -> tuple[float, float, float, float]:
    """Return the mean of inputs (K, 4), one a unit of time, the last one held."""
    last = len(inputs) - 1
    first = min(int(begin + _ROUNDING), last)
    if end <= first + 1 + _ROUNDING or first == last:
        return inputs[first, 0], inputs[first, 1], inputs[first, 2], inputs[first, -1]  # exactly
    a = b = c = d = 0.0
    for k in range(first, last + 1):
        until = end if k == last else min(end, k + 1.0)
        share = max(until - max(begin, float(k)), 0.0) / (end - begin)
        a += share * inputs[k, 0]
        b += share * inputs[k, 1]
        c += share * inputs[k, 2]
        d += share * inputs[k, -1]
        if until >= end:
            break
    return a, b, c, d
