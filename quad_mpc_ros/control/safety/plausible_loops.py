# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether body rates follow their commands like a ringing or slow rate loop.

Such a loop turns against its command temporarily, a reversed axis permanently. So the rates of
each axis are compared with the rates of a few loops (:mod:`..model.actuators`). A loop explains an
axis if the residual is below 0.85 times the variance of the rates of the last seconds, or
no more than a slow motion. Saturated rotors limit the angular acceleration: the loops have bounds
that follow from the vehicle's own.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation.loop_rates import FLOOR, LoopRates
from quad_mpc_ros.control.lie import Array

# (tau, T) of each axis [s]: three loops of a damping ratio of 0.7, two that ring.
_LOOPS = np.array([(0.12, 0.06), (0.24, 0.12), (0.4, 0.2), (0.04, 0.06), (0.04, 0.16)])
PLAUSIBLE_LOOPS = np.repeat(_LOOPS[:, None], 3, axis=1)
_LEFT_SHARE = 0.85  # of the squares

_OfLoops = Annotated[Array, (len(_LOOPS), 3)]


class PlausibleRates(LoopRates):
    """Rates of several loops."""

    rates: _OfLoops
    acceleration: _OfLoops
    expected: _OfLoops
    mean_expected: _OfLoops
    left: _OfLoops


@compiled
def are_explained(state: PlausibleRates) -> bool:
    """Whether some loop explains the rates of each axis."""
    for axis in range(3):
        least = math.inf
        for k in range(len(_LOOPS)):
            least = min(least, state.left[k, axis])
        if least > max(_LEFT_SHARE * state.squares[axis], FLOOR * FLOOR):
            return False
    return True
