# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Progress along the reference as a variable of the problem: state, input and cost.

A reference is a path p(θ), v(θ), a(θ) of its own time θ, and θ advances at a speed ν_i >= 0 in
each stage, which the problem chooses. After the vehicle's states come two states, θ and the speed
of the previous stage, and after the vehicle's inputs an input:

    θ_{i+1} = θ_i + h ν_i,    s_{i+1} = ν_i

The tracked point is the path at the progress θ, with the speed s; the speed has a cost:

    e_p = p_i - p(θ_i),   e_v = v_i - s_i v(θ_i),   J += sum_{i=0..N-1} w (ν_i - 1)^2

so that the errors have derivatives with respect to progress, de_p/dθ = -v, de_v/dθ = -s a and
de_v/ds = -v. This is model predictive contouring control (Lam, Manzie, Good, CDC 2010; for
quadrotors Romero, Sun, Foehn, Scaramuzza, T-RO 2022) with one weight on distance from the path and
on lag along the path: where progress is free, its weight determines the lag. Tracked attitudes and
reference inputs follow from the progress at the start of a tick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.jacobians import STATE_SIZE
from quad_mpc_ros.control.model.reference_window import PointRecord, SampleRecord, sample_into
from quad_mpc_ros.control.model.state import INPUT_SIZE, P, V
from quad_mpc_ros.control.model.target import TargetStage, path_times
from quad_mpc_ros.control.ocp.horizon_qp import HorizonStages, Mask
from quad_mpc_ros.control.ocp.settings import ProblemSettings, stage_weight

PATH_TIME, SPEED, SIZE = STATE_SIZE, STATE_SIZE + 1, STATE_SIZE + 2
"""Indices of progress and its speed in the state of the problem, and its size."""
SPEED_INPUT, INPUTS = INPUT_SIZE, INPUT_SIZE + 1
"""Index of the speed in the input of the problem, and its size."""
STATE_SIZES, INPUT_SIZES = np.array([0.07, 0.3]), np.array([0.1])
"""Natural sizes of the two states and of the input."""
SPEED_MIN, SPEED_MAX = 0.2, 1.05
"""Bounds of the speed of progress, relative to the speed of the reference."""

# Cost of a change of the speed near limits, in proportion to the same scale as other changes of
# the plan. Without it the slowest problems are those with a steep slope: the cost of progress
# is then next to nothing, and progress goes from one bound to the other. It takes a third of the
# iterations of the slowest random problems.
_DAMPING_SPEED = 0.1 / 0.3**2


class ProgressBuffers(NamedTuple):
    """Speeds of progress in each stage (N,), of the nominal plan and of the last plan.

    ``path`` (N,) is the reference at the progress at the ends of the stages; ``shift`` (3,) is the
    target's distance from the path if the position error saturates. All fields are empty if the
    reference is tracked in time.
    """

    nominal: Array
    plan: Array
    path: RecordArray[PointRecord]
    shift: Array

    @staticmethod
    def zeros(steps: int) -> ProgressBuffers:
        """Return N stages in real time."""
        return ProgressBuffers(
            np.ones(steps), np.ones(steps), PointRecord.zeros(steps), np.zeros(3 * min(steps, 1))
        )


def mark_progress(A: Mask, B: Mask, H: Mask) -> None:
    """Mark the entries of progress in the pattern of a stage."""
    A[PATH_TIME, PATH_TIME] = True
    B[PATH_TIME, SPEED_INPUT] = B[SPEED, SPEED_INPUT] = True
    for k in range(3):
        for row, column in ((P + k, PATH_TIME), (V + k, PATH_TIME), (V + k, SPEED)):
            H[row, column] = H[column, row] = True
    H[PATH_TIME:SIZE, PATH_TIME:SIZE] = True


@compiled
def follow_path(
    elapsed_ns: int,
    samples: RecordArray[SampleRecord],
    step: float,
    speeds: Array,
    progress: ProgressBuffers,
    target: RecordArray[TargetStage],
) -> None:
    """Move positions and velocities of a target (N,) along the reference with speeds (N,).

    Start ``elapsed_ns`` after the stamp of the window with the ``samples`` (n,).
    """
    times_ns = np.empty(len(speeds) + 1, np.int64)
    path_times(speeds, step, elapsed_ns, times_ns)
    sample_into(times_ns[1:], samples, progress.path)
    for i in range(len(speeds)):
        point, stage = progress.path[i], target[i]
        for k in range(3):
            stage.p_WB[k] = point.p_WB[k] + progress.shift[k]
            stage.v_WB_W[k] = speeds[i] * point.v_WB_W[k]


@compiled
def progress_cost(settings: ProblemSettings, speeds: Array) -> float:
    """Return the cost of speeds (N,) that differ from 1."""
    cost = 0.0
    for i in range(len(speeds)):
        cost += settings.progress_weight * (speeds[i] - 1.0) ** 2
    return cost


@compiled
def regularise_progress(weight: float, scale: float, stages: HorizonStages) -> None:
    """Add a cost on changes of the speed to its ``weight``, at the scale of the limits."""
    for i in range(len(stages.R)):
        stages.R[i, SPEED_INPUT] = weight + _DAMPING_SPEED * scale


@compiled
def write_progress(
    settings: ProblemSettings, errors: Array, progress: ProgressBuffers, stages: HorizonStages
) -> None:
    """Write dynamics, cost and bounds of the nominal progress at errors (N, 9) of the vehicle.

    The stages already contain the cost of the vehicle's state, with these weights.
    """
    for i in range(len(errors)):
        H, g, speed, point = stages.H[i], stages.g[i], progress.nominal[i], progress.path[i]
        by_time = by_speed = 0.0
        time_time = time_speed = speed_speed = 0.0
        factor = stage_weight(settings, i, len(errors))
        for k in range(3):
            v, a = point.v_WB_W[k], speed * point.a_WB_W[k]
            of_p, of_v = factor * settings.Q[P + k], factor * settings.Q[V + k]
            H[P + k, PATH_TIME] = H[PATH_TIME, P + k] = -of_p * v
            H[V + k, PATH_TIME] = H[PATH_TIME, V + k] = -of_v * a
            H[V + k, SPEED] = H[SPEED, V + k] = -of_v * v
            time_time += of_p * v * v + of_v * a * a
            time_speed += of_v * a * v
            speed_speed += of_v * v * v
            by_time -= of_p * v * errors[i, P + k] + of_v * a * errors[i, V + k]
            by_speed -= of_v * v * errors[i, V + k]
        H[PATH_TIME, PATH_TIME], H[SPEED, SPEED] = time_time, speed_speed
        H[PATH_TIME, SPEED] = H[SPEED, PATH_TIME] = time_speed
        g[PATH_TIME], g[SPEED] = by_time, by_speed
        stages.A[i, PATH_TIME, PATH_TIME] = 1.0
        stages.B[i, PATH_TIME, SPEED_INPUT], stages.B[i, SPEED, SPEED_INPUT] = settings.step, 1.0
        stages.R[i, SPEED_INPUT] = settings.progress_weight
        stages.r[i, SPEED_INPUT] = settings.progress_weight * (speed - 1.0)
        stages.lower[i, SPEED_INPUT] = min(SPEED_MIN - speed, 0.0)
        stages.upper[i, SPEED_INPUT] = max(SPEED_MAX - speed, 0.0)
