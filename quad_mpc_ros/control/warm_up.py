# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compilation of all code before the first tick."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from quad_mpc_ros.configuration import optional_part
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.control_law import ControlLaw
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.guide import Guide
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.mpc import Mpc, NewPlanner

# Close enough for the estimator to learn between them, and longer than any input delay.
_TICKS_NS = (1_000_000_000, 1_300_000_000, 1_600_000_000, 1_620_000_000)
_BLIND_NS = 5_000_000_000  # later than any timeout below
_HOVERING_NS = (5_100_000_000, 6_000_000_000)

_SPEED = 0.3  # m/s


def warmed_up(
    config: MpcConfig,
    *,
    deadline: float = math.inf,
    guide: Guide | None = None,
    law: ControlLaw | None = None,
) -> Controller:
    """Return a new controller with all code compiled.

    ``law`` replaces the MPC or the controller of ``config.controller``. Raises
    :class:`UserError` if ``config.controller`` cannot be created.
    """
    planner: NewPlanner = Mpc
    if law is not None or config.controller != MPC:
        planner = optional_part("law_planner", needed_by="mpc.controller")(config, law)
    _compile(
        dataclasses.replace(
            config,
            # With these weights the turn takes several iterations.
            Q=(1e-3,) * 6 + (1.0,) * 3,
            R=(1e-3,) * 4,
            terminal_weight=1.0,
            horizon_steps=2,
            lockstep=False,
            odom_timeout=2.0,
            reference_timeout=2.0,
            plan_hold_time=0.2,
            blind_time=10.0,
        )
    )
    return Controller(config, deadline=deadline, guide=guide, planner=planner)


def compile_problem(config: MpcConfig) -> None:
    """Compile the optimal control problem, without the estimation."""
    mpc = Mpc(config)
    state = PredictedState.at_rest(parameters_of(config.vehicle(), config.lags))
    for stamp_ns in _TICKS_NS:
        window = ReferenceWindow.hover(_position(stamp_ns), stamp_ns=stamp_ns)
        mpc.solve(state._replace(stamp_ns=stamp_ns), window)


def compile_estimation(config: MpcConfig) -> None:
    """Compile the estimation, without the optimal control problem."""
    compensation = DelayCompensation(config)
    for stamp_ns in _TICKS_NS:
        compensation.predict(_moving_at(stamp_ns, config))
        compensation.record(Input(throttle=0.3, w_WB_B=np.zeros(3)), stamp_ns=stamp_ns)


@functools.cache
def _compile(config: MpcConfig) -> None:
    """Run a few control steps of a controller whose commands are discarded."""
    controller, frame_id = Controller(config), config.odometry.frame_id
    for stamp_ns in _TICKS_NS:
        held = ReferenceWindow.hover(_position(stamp_ns), stamp_ns=stamp_ns, frame_id=frame_id)
        controller.receive_reference(held, now_ns=stamp_ns)
        controller.receive_odometry(_moving_at(stamp_ns, config), now_ns=stamp_ns)
        controller.take_warnings()
    # Then without odometry, and last without reference, so that the fallbacks compile as well.
    controller.watch(now_ns=_BLIND_NS)
    for stamp_ns in _HOVERING_NS:
        controller.receive_odometry(_moving_at(stamp_ns, config), now_ns=stamp_ns)
        controller.take_warnings()


def _moving_at(stamp_ns: int, config: MpcConfig) -> OdometrySample:
    """Return an odometry in slow flight with another heading, so that the estimator is active."""
    yaw = 2.0
    resting = OdometrySample.at_rest(
        _position(stamp_ns), yaw=yaw, stamp_ns=stamp_ns, frame_id=config.odometry.frame_id
    )
    v_WB_B = _SPEED * np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    return dataclasses.replace(resting, v_WB_B=v_WB_B)


def _position(stamp_ns: int) -> Array:
    return np.array([_SPEED * 1e-9 * stamp_ns, 0.0, 0.0])
