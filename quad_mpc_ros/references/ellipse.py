"""An ellipse, level or upright, with a choice of headings.

With semi-axes A and B around the origin, x = A sin(w t), and y, or z of an upright one, is
B cos(w t). On a level one the nose may point to the centre or along the path: both headings follow
from the path in closed form, without jumps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.path import PathSamples
from quad_mpc_ros.references.trajectory import TrajectoryParameters


@dataclass(frozen=True, kw_only=True)
class EllipseParameters(TrajectoryParameters):
    """The ellipse's own."""

    ellipse_semi_axes: tuple[float, ...] = parameter(
        (3.0, 1.5),
        doc="ellipse: its semi-axes, along x and along y, or with an upright one along z.",
        unit="m",
        length=2,
        above=0.0,
        maximum=1e4,
    )
    ellipse_frequency: float = parameter(
        1.0,
        doc="ellipse: angle of its oscillations per time.",
        unit="rad/s",
        minimum=0.001,
        maximum=1e3,
    )
    ellipse_plane: str = parameter(
        "horizontal",
        doc="ellipse: whether it lies, in x and y, or stands, in x and z.",
        choices=("horizontal", "vertical"),
    )
    ellipse_heading: str = parameter(
        "fixed",
        doc="ellipse: where the nose looks, turned by yaw: always the same way, or of a "
        "horizontal one to the centre or along its way.",
        choices=("fixed", "centre", "along"),
    )

    def check(self) -> None:
        """Refuse a heading that an upright ellipse does not define."""
        super().check()
        if self.ellipse_plane == "vertical" and self.ellipse_heading != "fixed":
            raise ConfigurationError(
                f"{self.owner}.ellipse_heading",
                self.ellipse_heading,
                "fixed, with ellipse_plane vertical",
            )


class Ellipse:
    """The ellipse, repeated; at t = 0 in full motion eastwards, at +B."""

    periodic = True

    def __init__(self, config: EllipseParameters) -> None:
        self._centre = np.array([*config.origin, config.height])
        a, b = config.ellipse_semi_axes
        level = config.ellipse_plane == "horizontal"
        self._sine = np.array([a, 0.0, 0.0])
        self._cosine = np.array([0.0, b, 0.0] if level else [0.0, 0.0, b])
        self._semi_axes = a, b
        self._frequency = config.ellipse_frequency
        self._heading = config.ellipse_heading
        self.duration = math.tau / self._frequency

    def at(self, seconds: Array) -> PathSamples:
        """Return the ellipse at times (n,) [s]."""
        angle, w = self._frequency * seconds, self._frequency
        sine, cosine = np.sin(angle)[:, None], np.cos(angle)[:, None]
        outwards = sine * self._sine + cosine * self._cosine
        along = cosine * self._sine - sine * self._cosine
        yaw, yaw_rate = self._nose(angle)
        return PathSamples(
            p_WB=self._centre + outwards,
            v_WB_W=w * along,
            a_WB_W=-(w**2) * outwards,
            j_WB_W=-(w**3) * along,
            yaw=yaw,
            yaw_rate=yaw_rate,
        )

    def _nose(self, angle: Array) -> tuple[Array, Array]:
        """Return yaw [rad] and its rate [rad/s] (n,) at angles (n,) [rad]."""
        if self._heading == "fixed":
            return np.zeros_like(angle), np.zeros_like(angle)
        if self._heading == "along":  # the velocity is as the place a quarter further on
            direction, rate = self._direction(angle + 0.5 * math.pi)
            return direction, rate
        direction, rate = self._direction(angle)
        return direction - math.pi, rate

    def _direction(self, angle: Array) -> tuple[Array, Array]:
        """Return the continuous direction of (A sin, B cos), and its rate."""
        a, b = self._semi_axes
        s, c = np.sin(angle), np.cos(angle)
        ahead = np.arctan2((a - b) * s * c, a * s * s + b * c * c)
        rate = -self._frequency * a * b / ((a * s) ** 2 + (b * c) ** 2)
        return 0.5 * math.pi - angle - ahead, rate
