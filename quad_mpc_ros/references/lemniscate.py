# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A lemniscate, x = A_x sin(w t) and y = A_y sin(2 w t), at a constant heading.

Smooth and, by differential flatness with drag, complete: attitude, body rates and acceleration
belong to the path. The path crosses the origin at t = 0, at full speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.references.ellipse import LissajousPath
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


def lemniscate(config: LemniscateParameters) -> LissajousPath:
    """Return the configured lemniscate."""
    return LissajousPath(
        np.array([*config.origin, config.height]),
        sine=np.array([config.amplitude_x, config.amplitude_y, 0.0]),
        cosine=np.zeros(3),
        frequency=config.angular_frequency,
        multiples=(1.0, 2.0, 0.0),
    )
