# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An ellipse, horizontal or vertical, with a choice of headings, and the circle.

With semi-axes A and B around the origin, x = A sin(w t), and y, or z of a vertical ellipse, is B
cos(w t). On a horizontal ellipse the nose may point to the centre or along the path: both headings
follow from the path in closed form, without jumps.
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
class CircleParameters(TrajectoryParameters):
    """Parameters of a circle."""

    circle_radius: float = parameter(2.0, doc="circle: radius.", unit="m", above=0.0, maximum=1e4)
    circle_speed: float = parameter(
        2.0, doc="circle: speed along the circle.", unit="m/s", above=0.0, maximum=1e3
    )


@dataclass(frozen=True, kw_only=True)
class EllipseParameters(TrajectoryParameters):
    """Parameters of an ellipse."""

    ellipse_semi_axes: tuple[float, ...] = parameter(
        (3.0, 1.5),
        doc="ellipse: semi-axes along x and y, or along x and z if the plane is vertical.",
        unit="m",
        length=2,
        above=0.0,
        maximum=1e4,
    )
    ellipse_frequency: float = parameter(
        1.0,
        doc="ellipse: angular frequency.",
        unit="rad/s",
        minimum=0.001,
        maximum=1e3,
    )
    ellipse_plane: str = parameter(
        "horizontal",
        doc="ellipse: plane of the path, x and y or x and z.",
        choices=("horizontal", "vertical"),
    )
    ellipse_heading: str = parameter(
        "fixed",
        doc="ellipse: heading, to which yaw is added: constant, or, in a horizontal plane, to "
        "the centre or along the path.",
        choices=("fixed", "centre", "along"),
    )

    def check(self) -> None:
        """Reject a heading that a vertical ellipse does not define."""
        super().check()
        if self.ellipse_plane == "vertical" and self.ellipse_heading != "fixed":
            raise ConfigurationError(
                f"{self.owner}.ellipse_heading",
                self.ellipse_heading,
                "fixed, with ellipse_plane vertical",
            )


class LissajousPath:
    """The path centre + ``sine`` sin(k w t) + ``cosine`` cos(k w t), (3,) each [m], repeated.

    A ``heading`` of ``centre`` or ``along`` requires the semi-axes of an ellipse along x and y.
    """

    periodic = True

    def __init__(
        self,
        centre: Array,
        *,
        sine: Array,
        cosine: Array,
        frequency: float,
        multiples: tuple[float, float, float] = (1.0, 1.0, 1.0),
        heading: str = "fixed",
    ) -> None:
        """Take the vectors [m], the angular frequency w [rad/s], k of each axis, the heading."""
        self._centre, self._sine, self._cosine = centre, sine, cosine
        self._frequency, self._heading = frequency, heading
        self._rates = frequency * np.array(multiples)
        self.duration = math.tau / frequency

    def at(self, seconds: Array) -> PathSamples:
        """Return the path at times (n,) [s]."""
        w = self._rates
        sine, cosine = np.sin(seconds[:, None] * w), np.cos(seconds[:, None] * w)
        outwards = sine * self._sine + cosine * self._cosine
        along = cosine * self._sine - sine * self._cosine
        yaw, yaw_rate = self._nose(self._frequency * seconds)
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
            return self._direction(angle + 0.5 * math.pi)
        direction, rate = self._direction(angle)
        return direction - math.pi, rate

    def _direction(self, angle: Array) -> tuple[Array, Array]:
        """Return the continuous direction of (A sin, B cos), and its rate."""
        a, b = self._sine[0], self._cosine[1]
        s, c = np.sin(angle), np.cos(angle)
        ahead = np.arctan2((a - b) * s * c, a * s * s + b * c * c)
        rate = -self._frequency * a * b / ((a * s) ** 2 + (b * c) ** 2)
        return 0.5 * math.pi - angle - ahead, rate


def ellipse(config: EllipseParameters) -> LissajousPath:
    """Return the configured ellipse; at t = 0 at +B, at full speed eastwards."""
    a, b = config.ellipse_semi_axes
    is_level = config.ellipse_plane == "horizontal"
    return LissajousPath(
        np.array([*config.origin, config.height]),
        sine=np.array([a, 0.0, 0.0]),
        cosine=np.array([0.0, b, 0.0] if is_level else [0.0, 0.0, b]),
        frequency=config.ellipse_frequency,
        heading=config.ellipse_heading,
    )


def circle(config: CircleParameters) -> LissajousPath:
    """Return the configured circle, anticlockwise; at t = 0 at full speed, east of the origin."""
    radius = config.circle_radius
    return LissajousPath(
        np.array([*config.origin, config.height]),
        sine=np.array([0.0, radius, 0.0]),
        cosine=np.array([radius, 0.0, 0.0]),
        frequency=config.circle_speed / radius,
    )
