"""What is configured of the manifold problem, as compiled code takes it."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3, Vector4
from quad_mpc_ros.control.config import LimitParameters, MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import POSITION, TANGENT_SIZE


class Settings(Record):
    """What is configured of the problem."""

    Q: Annotated[Array, (TANGENT_SIZE,)]  # weights of position, velocity and attitude
    R: Vector4  # weights of throttle and rates
    terminal_weight: float  # factor on Q at the last stage
    step: float  # s, of a stage
    # Bounds of throttle and rates.
    u_min: Vector4
    u_max: Vector4
    rate_gain: Vector3  # of the rates over their commands
    limits: Vector4  # soft ones, by kind, 0 for none
    distance: float  # m, a reference further away pulls as if it were that near
    steep: float  # a slope of the cost that is steep
    # Of how fast the reference's time passes: weight on its difference from 1, and bounds.
    progress_weight: float
    speed_min: float
    speed_max: float


def settings_of(config: MpcConfig) -> RecordArray[Settings]:
    """Return the settings of a configuration."""
    settings = Settings.zeros()
    given = settings[()]
    gain = np.array(per_axis(config.rate_gain))
    # Inputs of the problem are what the rates follow, commands times their gain.
    fastest = gain * config.omega_max
    given.Q[:], given.R[:], given.terminal_weight = config.Q, config.R, config.terminal_weight
    given.step, given.rate_gain[:] = config.horizon_step, gain
    given.u_min[:] = config.throttle_min, *(-fastest)
    given.u_max[:] = config.throttle_max, *fastest
    # A slew of commands is one of what the rates follow, of the axis that follows least.
    followed = np.array([1.0, 1.0, 1.0, min(gain)])
    given.limits[:] = followed * values_of(config.limits)
    contouring = config.contouring
    given.progress_weight = contouring.progress_weight
    given.speed_min, given.speed_max = contouring.speed_min, contouring.speed_max
    given.distance = config.limits.pull_distance
    # The slope of the cost where the position is off by the distance at which the pull stays
    # the same, per 3 m/s.
    duration = config.horizon_steps * config.horizon_step
    heaviest = max(config.terminal_weight, 1.0) * max(*config.Q[POSITION], 1e-9)
    given.steep = 3.0 * duration * heaviest * config.limits.pull_distance
    return settings


def values_of(limits: LimitParameters) -> Array:
    """Return the limits (4,) by kind, 0 for those that are off: tilt, speed, throttle, slew."""
    return np.array([limits.tilt_max, limits.speed_max, limits.throttle_margin, limits.rate_slew])
