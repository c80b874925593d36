# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A flight for identification: frequency sweeps along all axes at once about one position.

x, y, z and the rotation about body z oscillate with a frequency that sweeps between a highest and
the lowest that covers the full reach within the bounds: slow, wide oscillations excite drag, fast,
small oscillations lags and delay. x sweeps upwards, y downwards, z up and down, the rotation down
and up, so that no two frequencies coincide for long. The amplitude follows from reach, speed and
acceleration at each frequency; the motion starts and ends at rest. Positions are sampled first,
and a spline through the samples gives the derivatives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter, per_axis
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.minimum_snap import snap_spline
from quad_mpc_ros.references.path import Path, SmoothTurn, SplinePath, with_lowest_point
from quad_mpc_ros.references.trajectory import TrajectoryParameters

_PER_PERIOD, _FEWEST = 48, 100.0  # samples of the quickest oscillation, and in a second
_RAMP, _LARGEST_RAMP = 2.0, 0.25  # s, share of the whole
_MINIMUM_SHARPNESS = 8.0  # sharpness of the smooth minimum over the bounds
# Highest frequencies [Hz]: yaw is weak.
_FREQUENCY, _YAW_FREQUENCY = 2.0, 0.3 * 2.0
_VERTICAL_ACCELERATION = 0.3  # largest, over gravity
_MOST_YAW, _YAW_RATE = 0.6, 0.7  # rad to either side, rad/s
_SLOW_EXPONENT = 3.0  # larger: x, y and z stay slow for longer
_PHASES = {"x": 0.0, "y": 0.0, "z": 0.5 * math.pi, "yaw": 0.0}  # phases
_ITERATIONS = 4


@dataclass(frozen=True, kw_only=True)
class ExcitationParameters(TrajectoryParameters):
    """Parameters of the sweeps."""

    excitation_duration: float = parameter(
        20.0, doc="excitation: duration.", unit="s", minimum=5.0, maximum=120.0
    )
    excitation_reach: tuple[float, ...] = parameter(
        (2.0, 2.0, 1.0),
        doc="excitation: largest distance from the centre east, north and up.",
        unit="m",
        length=3,
        above=0.0,
        maximum=100.0,
    )
    excitation_speed: float = parameter(
        4.0,
        doc="excitation: highest speed east, north and up, each.",
        unit="m/s",
        above=0.0,
        maximum=50.0,
    )
    excitation_tilt: float = parameter(
        0.7, doc="excitation: largest tilt.", unit="rad", above=0.0, maximum=1.2
    )


def excitation(config: ExcitationParameters) -> Path:
    """Return the configured sweeps, with the lowest point at the configured height."""
    sweeps = _Sweeps(config)
    places = sweeps.positions()
    middle = np.array([*config.origin, 0.0])
    values = np.column_stack((middle + places, sweeps.yaw(places)))
    path = SplinePath(snap_spline(values, sweeps.seconds), duration=sweeps.duration)
    return with_lowest_point(path, config.height)


class _Sweeps:
    """The sweeps at times ``seconds`` (n,) [s], fine enough for a spline."""

    def __init__(self, config: ExcitationParameters) -> None:
        self._config = config
        self.duration = config.excitation_duration
        count = math.ceil(max(_PER_PERIOD * _FREQUENCY, _FEWEST) * self.duration)
        self.seconds = np.linspace(0.0, self.duration, count + 1)
        ramp = SmoothTurn(1.0, duration=min(_RAMP, _LARGEST_RAMP * self.duration))
        self._envelope = ramp.at(self.seconds)[0] * ramp.at(self.duration - self.seconds)[0]
        share = self.seconds / self.duration
        around = 0.5 * (1.0 - np.cos(math.tau * share))
        slowly = {"x": share, "y": 1.0 - share, "z": around}
        self._shares = {axis: each**_SLOW_EXPONENT for axis, each in slowly.items()}
        self._shares["yaw"] = 1.0 - around

    def positions(self) -> Array:
        """Return the positions (n, 3) [m] about the centre, within reach, speed and tilt."""
        config = self._config
        up = self._bounded("z", config.excitation_reach[2], _VERTICAL_ACCELERATION)
        steepest = math.tan(config.excitation_tilt)
        # East and north share the tilt, and with it the acceleration that either may have.
        acceleration = steepest
        for _ in range(_ITERATIONS):
            level = [
                self._bounded(axis, config.excitation_reach[place], acceleration)
                for place, axis in enumerate(("x", "y"))
            ]
            places = np.column_stack((*level, up))
            steepness = self._steepness(places)
            acceleration *= steepest / steepness
        places[:, :2] *= min(1.0, steepest / steepness)
        return places

    def yaw(self, places: Array) -> Array:
        """Return the yaw (n,) [rad] at positions (n, 3) [m] for a sweep about the body's z axis.

        The heading changes when a body tilts in changing directions, which a vehicle with little
        torque about z could not compensate fast enough.
        """
        turns = self._within("yaw", (_MOST_YAW, _YAW_RATE, math.inf), highest=_YAW_FREQUENCY)
        force = self._force(places)
        x, y, z = (force / np.linalg.norm(force, axis=1, keepdims=True)).T
        added = np.cumsum((x * np.gradient(y) - y * np.gradient(x)) / (1.0 + z))
        # It slowly turns back to the initial heading.
        back = SmoothTurn(-float(added[-1]), duration=self.duration).at(self.seconds)[0]
        return np.asarray(turns + added + back)

    def _bounded(self, axis: str, reach: float, acceleration: float) -> Array:
        """Return the sweep of an axis (n,) [m] within its reach [m] and acceleration [g]."""
        config = self._config
        bounds = (reach, config.excitation_speed, acceleration * config.gravity)
        return self._within(axis, bounds, highest=_FREQUENCY)

    def _within(self, axis: str, bounds: tuple[float, ...], *, highest: float) -> Array:
        """Return a sweep (n,) with value and first two derivatives within bounds."""
        share, step = self._shares[axis], self.seconds[1]
        reach, speed, acceleration = bounds
        # Below this frequency only the reach limits it.
        slowest = min(speed / reach, math.sqrt(acceleration / reach))
        quickest = max(math.tau * highest, slowest)
        frequency = slowest * (quickest / slowest) ** share
        phase = np.concatenate(([0.0], np.cumsum(0.5 * step * (frequency[1:] + frequency[:-1]))))
        needed = sum(
            (frequency**n / bound) ** _MINIMUM_SHARPNESS for n, bound in enumerate(bounds)
        )
        sweep = (
            self._envelope * needed ** (-1.0 / _MINIMUM_SHARPNESS) * np.sin(phase + _PHASES[axis])
        )
        changes = (sweep, np.gradient(sweep, step), np.gradient(np.gradient(sweep, step), step))
        excess = max(np.abs(c).max() / bound for c, bound in zip(changes, bounds, strict=True))
        return np.asarray(sweep / max(excess, 1.0))

    def _steepness(self, places: Array) -> float:
        """Return the largest tangent of the tilt."""
        force = self._force(places)
        return float((np.hypot(force[:, 0], force[:, 1]) / force[:, 2]).max())

    def _force(self, places: Array) -> Array:
        """Return the specific force (n, 3) [m/s^2], with the drag of a body that hovers."""
        v = np.gradient(places, self.seconds[1], axis=0)
        a = np.gradient(v, self.seconds[1], axis=0)
        drag = np.add(per_axis(self._config.drag), per_axis(self._config.rotor_drag))
        return np.asarray(a + drag * v + [0.0, 0.0, self._config.gravity])
