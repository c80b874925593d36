# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Weights and bounds of the optimal control problem, for compiled code."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3, Vector4
from quad_mpc_ros.control.config import LEAST_RATE_WEIGHT, MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import POSITION, TANGENT_SIZE


class ProblemSettings(Record):
    """Weights and bounds of the problem, as configured."""

    Q: Annotated[Array, (TANGENT_SIZE,)]  # weights of position, velocity and attitude
    R: Vector4  # weights of throttle and rates
    R_least: Vector4  # of rates, for a known rate loop
    terminal_weight: float  # factor on Q at the last stage
    step: float  # s, of a stage
    # Bounds of throttle and rates.
    u_min: Vector4
    u_max: Vector4
    rate_gain: Vector3  # of the rates over their commands
    tilt_max: float  # rad, soft; 0 for none
    speed_max: float  # m/s, soft; 0 for none
    max_position_error: float  # m, at which the position error of the target saturates
    full_damping_slope: float  # slope of the cost from which on changes are regularised fully
    progress_weight: float  # on the difference of the speed of the reference's time from 1


@compiled
def stage_weight(settings: ProblemSettings, stage: int, steps: int) -> float:
    """Return the factor on Q at the end of a stage: the last stage has the terminal cost."""
    return settings.terminal_weight if stage == steps - 1 else 1.0


def settings_of(config: MpcConfig) -> RecordArray[ProblemSettings]:
    """Return the settings of a configuration."""
    result = ProblemSettings.zeros()
    settings, limits = result[()], config.limits
    gain = np.array(per_axis(config.rate_gain))
    # Inputs of the problem are what the rates follow, commands times their gain.
    fastest = gain * config.omega_max
    settings.Q[:], settings.R[:] = config.Q, config.R
    settings.R_least[:] = np.minimum(config.R, LEAST_RATE_WEIGHT)
    settings.terminal_weight = config.terminal_weight
    settings.step, settings.rate_gain[:] = config.horizon_step, gain
    settings.u_min[:] = config.throttle_min, *(-fastest)
    settings.u_max[:] = config.throttle_max, *fastest
    settings.tilt_max, settings.speed_max = limits.tilt_max, limits.speed_max
    settings.progress_weight = config.contouring.progress_weight
    settings.max_position_error = limits.position_error_max
    # The slope of the cost where the position is off by the distance at which its error
    # saturates, per 3 m/s.
    duration = config.horizon_steps * config.horizon_step
    heaviest = max(config.terminal_weight, 1.0) * max(*config.Q[POSITION], 1e-9)
    settings.full_damping_slope = 3.0 * duration * heaviest * limits.position_error_max
    return result
