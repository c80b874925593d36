"""A level circle, anticlockwise around its origin, with the nose where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.references.trajectory import TrajectoryParameters


@dataclass(frozen=True, kw_only=True)
class CircleParameters(TrajectoryParameters):
    """The circle's own."""

    circle_radius: float = parameter(
        2.0, doc="circle: its radius.", unit="m", above=0.0, maximum=1e4
    )
    circle_speed: float = parameter(
        2.0, doc="circle: speed along it.", unit="m/s", above=0.0, maximum=1e3
    )


class Circle:
    """The circle, repeated; at t = 0 in full motion, east of its origin."""

    periodic = True

    def __init__(self, config: CircleParameters) -> None:
        self._centre = np.array([*config.origin, config.height])
        self._radius = config.circle_radius
        self._frequency = config.circle_speed / config.circle_radius
        self.duration = math.tau / self._frequency

    def at(self, seconds: Array) -> PathSamples:
        """Return the circle at times (n,) [s]."""
        angle, w = self._frequency * seconds, self._frequency
        still = np.zeros_like(angle)
        outwards = self._radius * np.stack((np.cos(angle), np.sin(angle), still), axis=-1)
        along = self._radius * np.stack((-np.sin(angle), np.cos(angle), still), axis=-1)
        return PathSamples(
            p_WB=self._centre + outwards,
            v_WB_W=w * along,
            a_WB_W=-(w**2) * outwards,
            j_WB_W=-(w**3) * along,
        )
