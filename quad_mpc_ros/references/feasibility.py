# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Feasibility of a trajectory: required throttle, rates and height, and their limits.

The throttle follows from Newton's law with drag, the body rates are the trajectory's. Both are
checked every 2 ms, or at a thousand times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError, parameter
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.trajectory import (
    Trajectory,
    TrajectoryParameters,
    TrajectorySamples,
)

_SECOND_NS = 1_000_000_000
_CHECK_STEP_NS = 2_000_000
_LEAST_SAMPLES, _MOST_SAMPLES = 1000, 20_000
_PEAK_FACTOR = 7.0 / 6.0  # on omega_max, as peaks of some milliseconds are tolerable
_AXES = ("roll", "pitch", "yaw")
_GROUND_TOLERANCE = 0.05  # m, as smoothed recordings may dip below the ground


@dataclass(frozen=True, kw_only=True)
class FeasibilityParameters(TrajectoryParameters):
    """Limits of trajectories."""

    time_scaling: str = parameter(
        "none",
        doc="auto: slow down an infeasible trajectory until it is feasible; none: reject it.",
        choices=("none", "auto"),
    )
    throttle_min: float = parameter(
        0.0, doc="Lowest throttle that a trajectory may require.", minimum=0.0, maximum=1.0
    )
    throttle_max: float = parameter(
        1.0, doc="Highest throttle that a trajectory may require.", minimum=0.0, maximum=1.0
    )
    omega_max: tuple[float, ...] = parameter(
        (6.0 * math.pi, 6.0 * math.pi, 3.0 * math.pi),
        doc="Bound on the body rates of the vehicle (roll, pitch, yaw); a trajectory may exceed "
        "it by a sixth, because the vehicle can still fly short peaks.",
        unit="rad/s",
        length=3,
        above=0.0,
    )
    limit_margin: float = parameter(
        0.0,
        doc="Unused share of the range from hover to each limit that a trajectory must leave.",
        minimum=0.0,
        below=1.0,
    )

    @property
    def rate_limits(self) -> tuple[float, ...]:
        """Largest body rates of a trajectory (roll, pitch, yaw) [rad/s]."""
        return tuple(_PEAK_FACTOR * bound for bound in self.omega_max)

    def check(self) -> None:
        """Reject limits that forbid hovering."""
        super().check()
        hover = self.vehicle().hover_throttle
        for name, side, fits in (
            ("throttle_min", "below", self.throttle_min < hover),
            ("throttle_max", "above", self.throttle_max > hover),
        ):
            if not fits:
                raise ConfigurationError(
                    f"{self.owner}.{name}",
                    getattr(self, name),
                    f"a number {side} the hover throttle {hover:.4f}",
                )


@dataclass(frozen=True, kw_only=True, eq=False)
class Needs:
    """Requirements of a trajectory over time.

    Shapes: ``seconds``, ``throttle``, ``height`` [m], ``speed`` [m/s], ``acceleration`` [m/s^2]
    (n,); ``w_WB_B`` (n, 3) [rad/s]. A throttle outside 0 to 1 is extrapolated from the curve.
    """

    seconds: Array
    throttle: Array
    w_WB_B: Array
    height: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True, kw_only=True)
class Need:
    """The worst value of a requirement, its time [s], the limit, and the margin to the limit."""

    name: str
    unit: str
    worst: float
    time: float
    limit: float
    margin: float

    def complaint(self) -> str:
        """Return a line like ``'highest throttle 1.08 at 2.31 s, 0.08 beyond …'``."""
        return (
            f"{self.name} {self.worst:.4g}{self.unit} at {self.time:.3f} s, "
            f"{-self.margin:.3g}{self.unit} beyond the limit of {self.limit:.4g}{self.unit}"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Feasibility:
    """The worst requirements of a trajectory, the requirements over time, and its jumps [s].

    ``samples`` are the samples of the trajectory at the times of ``over_time``.
    """

    needs: tuple[Need, ...]
    over_time: Needs
    samples: TrajectorySamples
    limits: FeasibilityParameters
    jumps: tuple[float, ...]

    @property
    def feasible(self) -> bool:
        """Whether all limits are satisfied, without jumps."""
        return not self.jumps and not self.exceeded

    @property
    def exceeded(self) -> tuple[Need, ...]:
        """The requirements beyond their limits, or not finite."""
        return tuple(need for need in self.needs if not need.margin >= 0.0)

    def reason(self) -> str:
        """Return why the trajectory is not feasible, or an empty string."""
        complaints = [need.complaint() for need in self.exceeded]
        if self.jumps:
            complaints.append(f"{len(self.jumps)} jumps, the first at {self.jumps[0]:.3f} s")
        return "; ".join(complaints)


def rates_beyond(verdict: Feasibility, omega_max: Sequence[float]) -> list[tuple[Need, float]]:
    """Return the excess of required body rates over a controller's bounds (3,) [rad/s]."""
    rates = [need for need in verdict.needs if need.name.endswith("rate")]
    return [
        (need, bound) for need, bound in zip(rates, omega_max, strict=True) if need.worst > bound
    ]


def judged(
    trajectory: Trajectory, limits: FeasibilityParameters, *, ground: float = 0.0
) -> Feasibility:
    """Return the feasibility of a trajectory over its duration or period, or over 1 s at rest.

    ``ground`` [m] is the height of the ground.
    """
    vehicle = limits.vehicle()
    period = trajectory.period_ns or _SECOND_NS
    step = min(_CHECK_STEP_NS, period // _LEAST_SAMPLES)
    step = max(step, -(-period // _MOST_SAMPLES), 1)
    times = [*range(0, period, step), period]
    samples = trajectory.at(times)
    needs = needs_of(samples, vehicle, seconds=1e-9 * np.array(times))
    # A trajectory that begins in motion is also started in motion: see --start.
    jumps = trajectory.jumps(0, period - 1)
    return Feasibility(
        needs=_worst(needs, limits, hover=vehicle.hover_throttle, ground=ground),
        over_time=needs,
        samples=samples,
        limits=limits,
        jumps=tuple(1e-9 * jump for jump in jumps),
    )


def needs_of(samples: TrajectorySamples, vehicle: Vehicle, *, seconds: Array) -> Needs:
    """Return the requirements of samples at times (n,) [s]."""
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    thrust = vehicle.mass * vehicle.specific_thrust(
        a_WB_W=samples.a_WB_W, v_WB_W=samples.v_WB_W, R_WB=R_WB
    )
    return Needs(
        seconds=seconds,
        throttle=_throttle(vehicle, thrust),
        w_WB_B=np.einsum("nji,nj->ni", R_WB, samples.w_WB_W),
        height=samples.p_WB[:, 2],
        speed=np.linalg.norm(samples.v_WB_W, axis=1),
        acceleration=np.linalg.norm(samples.a_WB_W, axis=1),
    )


def _throttle(vehicle: Vehicle, thrust: Array) -> Array:
    """Return throttles (n,) for thrusts (n,) [N], also beyond the vehicle's range."""
    a, b, c = vehicle.thrust_curve
    wanted = thrust / vehicle.motor_count - c
    # The root of Vehicle.throttle_for. Below its least thrust the curve is mirrored, because the
    # slope there may be zero.
    size = np.abs(wanted)
    root = np.sqrt(b * b + 4.0 * a * size)
    return np.asarray(2.0 * wanted / np.maximum(b + root, np.finfo(float).tiny))


def _worst(
    needs: Needs, limits: FeasibilityParameters, *, hover: float, ground: float
) -> tuple[Need, ...]:
    share = 1.0 - limits.limit_margin
    highest = hover + share * (limits.throttle_max - hover)
    lowest = hover + share * (limits.throttle_min - hover)
    found = [
        _need("highest throttle", "", needs.throttle, needs, highest),
        _need("lowest throttle", "", needs.throttle, needs, lowest, least=True),
    ]
    for axis, rates, bound in zip(_AXES, needs.w_WB_B.T, limits.rate_limits, strict=True):
        found.append(_need(f"{axis} rate", " rad/s", np.abs(rates), needs, share * bound))
    lowest = ground - _GROUND_TOLERANCE
    found.append(_need("lowest height", " m", needs.height, needs, lowest, least=True))
    return tuple(found)


def _need(
    name: str, unit: str, values: Array, needs: Needs, limit: float, *, least: bool = False
) -> Need:
    place = int(np.argmin(values) if least else np.argmax(values))
    worst = float(values[place])
    return Need(
        name=name,
        unit=unit,
        worst=worst,
        time=float(needs.seconds[place]),
        limit=limit,
        margin=worst - limit if least else limit - worst,
    )
