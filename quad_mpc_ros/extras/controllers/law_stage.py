# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The stage that plans with a controller other than the MPC, and checks its commands."""

from __future__ import annotations

import functools
import time

import numpy as np

from quad_mpc_ros.configuration import ArgumentError
from quad_mpc_ros.configuration.arguments import array, instance
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.control_law import ControlLaw
from quad_mpc_ros.control.guide import Guided
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    OdometrySample,
    ReferenceWindow,
    RotorCommand,
)
from quad_mpc_ros.control.model.state import state_from_odometry
from quad_mpc_ros.control.mpc import MpcStep, NewPlanner, Planned, Planner
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.qp_solver import QpSolution
from quad_mpc_ros.control.stage import Due, Failure, StageLog
from quad_mpc_ros.extras.controllers.registry import configured_law

_NO_ODOMETRY = Failure("plan", "the controller needs odometry")


def law_planner(config: MpcConfig, law: ControlLaw | None = None) -> NewPlanner:
    """Return the stage of ``law``, by default of the controller ``mpc.controller``.

    Raises :class:`UserError` for an unknown name, and if the controller cannot be created.
    """
    return functools.partial(LawStage, law or configured_law(config))


class LawStage(Planner):
    """Takes commands from a controller along the guided window.

    After an exception or an unusable command the controller stays out until it is engaged again.
    A late command is dropped, but not the first one.
    """

    def __init__(self, law: ControlLaw, config: MpcConfig, deadline: float, log: StageLog) -> None:
        """``deadline`` [s] is the longest time of a step; later commands are dropped.

        In lockstep, where time stands still, the controller has the same share of a control
        period, but of processor time, so that results do not depend on the load.
        """
        self.law, self.commands_rotors = law, bool(getattr(law, "commands_rotors", False))
        self._kind = RotorCommand if self.commands_rotors else CommandSample
        self._log, self._deadline, self._clock = log, deadline, time.perf_counter
        if config.lockstep:
            self._deadline, self._clock = config.deadline / config.control_rate, time.thread_time
        self._period, self._motor_count = 1.0 / config.control_rate, config.motor_count
        self._horizon = config.horizon_steps * config.horizon_step
        self._needs_reset = True
        self._is_first = True  # the first step may compile or load code
        self._fault: str | None = None

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Reset the controller before the next step: its coordinates have changed."""
        self._needs_reset = True

    def engage(self, engaged: bool) -> None:
        """Reset the controller before the first command that acts."""
        if engaged:
            self._needs_reset, self._fault = True, None

    def step(self, due: Due, state: PredictedState | Failure, guided: Guided | Failure) -> Planned:
        """Return the command as a plan, or the reason why no command exists."""
        if isinstance(guided, Failure):
            return Planned(None, guided)
        if isinstance(state, Failure):
            return Planned(None, state)
        if due.odometry is None:
            return Planned(None, _NO_ODOMETRY)
        if self._fault is not None:
            return Planned(None, self._log.no_plan(self._fault))
        try:
            if self._needs_reset:
                self.law.reset()
                self._needs_reset = False
            started, begun = time.perf_counter(), self._clock()
            command = self._command(due.odometry, guided.window)
            taken = self._clock() - begun
        except Exception as error:  # the fallbacks have to fly the vehicle in any case
            self._fault = f"error in the controller: {_text(error)}"
            self._log.warn(
                f"{self._fault}; it stays out until it is engaged again: correct it "
                "(docs/tutorials/your_controller.md)"
            )
            return Planned(None, self._log.no_plan(self._fault))
        now = time.perf_counter()
        step = MpcStep(
            plan=self._plan(due, command),
            solution=QpSolution(solved=True, status="solved"),
            iterations=0,
            solve_time=now - started,
            step_time=now - due.started,
            state=state,
        )
        is_first, self._is_first = self._is_first, False
        if taken > self._deadline and not is_first:
            late = f"late: the controller took {1e3 * taken:.1f} ms"
            return Planned(step, self._log.no_plan(late, counted="deadline_misses"))
        return Planned(step, None)

    def _command(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample:
        """Return the controller's command. Raises what the controller and the checks raise."""
        given = self.law.step(odometry, window_from(window, odometry.stamp_ns))
        command = instance(given, "command", self._kind).checked()
        if isinstance(given, RotorCommand):
            if not self.commands_rotors:
                expected = "CommandSample, or the attribute commands_rotors = True"
                raise ArgumentError("command", "RotorCommand", expected)
            count = self._motor_count
            rotors = array(given.rotor_throttles, "rotor_throttles", count, finite=True)
            command = RotorCommand(**vars(command), rotor_throttles=rotors.clip(0.0, 1.0))
        return command

    def _plan(self, due: Due, command: CommandSample) -> Plan:
        """Return the command as a plan, with the motion at constant velocity as prediction.

        If the next command is missing, the failsafe holds the throttle and the attitude first.
        """
        assert due.odometry is not None
        x = state_from_odometry(due.odometry)
        return Plan(
            stamp_ns=due.sent_ns,
            step=self._horizon,
            input_step=self._period,
            inputs=np.array(
                [[command.throttle, *command.w_WB_B], [command.throttle, 0.0, 0.0, 0.0]]
            ),
            p_WB=np.stack((x.p_WB, x.p_WB + self._horizon * x.v_WB_W)),
            R_WB=np.stack((x.R_WB, x.R_WB)),
            rotor_throttles=getattr(command, "rotor_throttles", None),
        )


def window_from(window: ReferenceWindow, stamp_ns: int) -> ReferenceWindow:
    """Return the part of a window from a time on, with a sample at that time."""
    elapsed_ns = stamp_ns - window.stamp_ns
    if elapsed_ns == int(window.offset_ns[0]):
        return window
    points = sample(window, [stamp_ns])
    rest = slice(int(window.offset_ns.searchsorted(elapsed_ns, side="right")), None)
    return ReferenceWindow(
        stamp_ns=stamp_ns,
        offset_ns=np.append(0, window.offset_ns[rest] - elapsed_ns),
        p_WB=np.vstack((points.p_WB, window.p_WB[rest])),
        q_WB_xyzw=np.vstack(
            (so3.quaternion_xyzw_from_rotation(points.R_WB), window.q_WB_xyzw[rest])
        ),
        v_WB_W=np.vstack((points.v_WB_W, window.v_WB_W[rest])),
        a_WB_W=np.vstack((points.a_WB_W, window.a_WB_W[rest])),
        w_WB_W=np.vstack((points.R_WB[0] @ points.w_WB_B[0], window.w_WB_W[rest])),
        frame_id=window.frame_id,
    )


def _text(error: Exception) -> str:
    """Return an error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
