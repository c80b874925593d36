# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A lemniscate, x = A_x sin(w t) and y = A_y sin(2 w t), at a constant heading.

Smooth and, by differential flatness with drag, complete: attitude, body rates and acceleration
belong to the path. The path crosses the origin at t = 0, at full speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.references.trajectory import TrajectoryParameters


@dataclass(frozen=True, kw_only=True)
class LemniscateParameters(TrajectoryParameters):
    """Parameters of a lemniscate."""

    amplitude_x: float = parameter(
        3.0, doc="lemniscate: largest distance east of the origin.", unit="m", minimum=0.0
    )
    amplitude_y: float = parameter(
        1.5, doc="lemniscate: largest distance north of the origin.", unit="m", minimum=0.0
    )
    angular_frequency: float = parameter(
        1.0,
        doc="lemniscate: angular frequency of the eastward oscillation; twice as high northward.",
        unit="rad/s",
        minimum=0.001,
    )


class Lemniscate:
    """The lemniscate, repeated."""

    periodic = True

    def __init__(self, config: LemniscateParameters) -> None:
        self._origin = np.array([*config.origin, config.height])
        self._amplitude = np.array([config.amplitude_x, config.amplitude_y, 0.0])
        self._frequency = config.angular_frequency * np.array([1.0, 2.0, 0.0])
        self.duration = math.tau / config.angular_frequency

    def at(self, seconds: Array) -> PathSamples:
        """Return the lemniscate at times (n,) [s]."""
        w = self._frequency
        phase = seconds[:, None] * w
        sine, cosine = self._amplitude * np.sin(phase), self._amplitude * np.cos(phase)
        return PathSamples(
            p_WB=self._origin + sine,
            v_WB_W=w * cosine,
            a_WB_W=-(w**2) * sine,
            j_WB_W=-(w**3) * cosine,
        )
