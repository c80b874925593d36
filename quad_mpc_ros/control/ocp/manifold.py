"""The manifold formulation: SQP on SO(3) with actuators and disturbance.

The variables are deviations δ from the inputs that hold the reference, one a stage
(:mod:`quad_mpc_ros.control.ocp.target`). An iteration linearises along a plan,

    x_{i+1} = f(x_i, u_r,i + δ_i)           rolled out from the present state: without defects
    dx_{i+1} = A_i dx_i + B_i dδ_i          exact Jacobians, control/model/jacobians.py
    min  sum 1/2 dx_i' H_i dx_i + g_i' dx_i + sum 1/2 dδ_i' R dδ_i + δ_i' R dδ_i

and takes the step δ + α dδ with the longest α of a few that lowers the true cost
(:mod:`.tracking_cost`), so a plan is never worse than the one it came from. As a
rule one iteration is enough: the real-time iteration of Diehl et al. (2005), warm started with the
last plan, shifted by the time that has passed. After a jump of the reference the plan that simply
holds the reference's inputs competes with the shifted one, and a few iterations follow.

The cost is the paper's: errors x_r ⊟ x weighted by Q, u_r - u by R, with the velocity in the world
frame, whose norm is the same, and the exact Jacobian of the attitude error. Where there are limits
(:mod:`quad_mpc_ros.control.ocp.limits`), breaking them costs, in the QP and in the line search.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.jacobians import RATE, STATE_SIZE, THROTTLE
from quad_mpc_ros.control.model.reference_window import SampleRecord, packed
from quad_mpc_ros.control.model.rollout import SUBSTEPS
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.model.state import (
    ATTITUDE,
    BODY_RATE,
    INPUT_SIZE,
    POSITION,
    TANGENT_SIZE,
    THETA,
    U_THROTTLE,
    VELOCITY,
)
from quad_mpc_ros.control.ocp import progress, sqp
from quad_mpc_ros.control.ocp.limits import LimitLayout
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.ocp.problem import PredictedState
from quad_mpc_ros.control.ocp.settings import settings_of
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages

_STATE_SIZES = np.concatenate((np.repeat([1.0, 3.0, 0.5, 5.0], 3), [0.3]))
_INPUT_SIZES = np.array([0.3, 5.0, 5.0, 5.0])

_CONVERGED = 0.95
# For how long after a flip of the reference the vehicle may be behind.
_RECOVERING_NS = 500_000_000


class _Room(NamedTuple):
    """Where a problem is written: with its limits, and with half-spaces or without."""

    limits: LimitLayout
    workspace: sqp.Workspace
    stages: HorizonStages


class ManifoldProblem:
    """Tracks the reference along the predicted trajectory; keeps the last plan from tick to tick.

    Who writes its workspace: the target and the plan linearised along :func:`.sqp.begin`, the
    latter also :func:`.sqp.relinearise`; the last plan :func:`.sqp.line_search` alone, with the
    new one. Where the solver fails it stays. Half-spaces on the position are in a problem of their
    own, which begins from the same plan, so that without a corridor nothing of them is solved.
    """

    is_deviation = True

    def __init__(self, config: MpcConfig) -> None:
        self._steps, self._step = config.horizon_steps, config.horizon_step
        lags = *per_axis(config.rate_time_constant), config.thrust_time_constant
        lagging = max(lags) > 0.0
        self._uneven = not config.drags_alike
        # Without lags rate and throttle are their commands and need no states of their own.
        self._size = STATE_SIZE if lagging else TANGENT_SIZE
        self._inputs, self.gives_way = INPUT_SIZE, config.formulation == "contouring"
        if self.gives_way:
            self._size, self._inputs = progress.SIZE, progress.INPUTS
        limits = LimitLayout(config.limits, inputs=self._inputs)
        workspace = sqp.Workspace.zeros(self._steps, limits, progress=self.gives_way)
        self._anywhere = self._here = self._room(limits, workspace)
        within = LimitLayout(config.limits, half_spaces=config.half_spaces, inputs=self._inputs)
        self._within = self._room(within, self._anywhere.workspace.within(within))
        self._window: ReferenceWindow | None = None
        self._samples = SampleRecord.zeros(0)
        self._flips_until_ns, self._flipping = 0, False
        self._last = 0, math.nan  # stamp and cost of the last plan
        # Of the present iterate: its cost, how many iterations are left, and whether the stages
        # are those about it.
        self._cost, self._iterations, self._linearised = 0.0, 0, False
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over weights and bounds; the last plan stays."""
        self._settings = settings_of(config)

    def _room(self, limits: LimitLayout, workspace: sqp.Workspace) -> _Room:
        stages = HorizonStages.zeros(
            self._steps, self._size, self._inputs, rows=limits.rows, slacks=limits.slacks
        )
        return _Room(limits, workspace, stages)

    def pattern(self, *, within: bool = False) -> HorizonPattern:
        """Return the sparsity of the Jacobians and of the cost."""
        limits = (self._within if within else self._anywhere).limits
        n, diagonal = self._size, np.eye(3, dtype=bool)
        A = np.zeros((progress.SIZE, progress.SIZE), dtype=bool)
        A[POSITION, POSITION] = A[POSITION, VELOCITY] = A[VELOCITY, VELOCITY] = diagonal
        A[:THETA, VELOCITY] |= self._uneven  # drag that differs between axes acts across
        A[:THETA, THETA:STATE_SIZE] = True
        A[ATTITUDE, THETA:THROTTLE] = True
        A[RATE, RATE] = diagonal
        A[THROTTLE, THROTTLE] = True
        B = np.zeros((progress.SIZE, self._inputs), dtype=bool)
        B[:THETA, :INPUT_SIZE] = True
        B[ATTITUDE, BODY_RATE] = True
        B[RATE, BODY_RATE] = diagonal
        B[THROTTLE, U_THROTTLE] = True
        H = np.zeros((progress.SIZE, progress.SIZE), dtype=bool)
        H[:THETA, :THETA] = np.eye(THETA, dtype=bool)
        H[ATTITUDE, ATTITUDE] = True
        if self.gives_way:
            progress.couple(A, B, H)
        return HorizonPattern(
            steps=self._steps,
            A=A[:n, :n],
            B=B[:n],
            H=H[:n, :n],
            state_size=np.append(_STATE_SIZES, progress.STATE_NATURAL)[:n],
            input_size=np.append(_INPUT_SIZES, progress.INPUT_NATURAL)[: self._inputs],
            limits=limits.pattern(n),
        )

    def begin(
        self, state: PredictedState, window: ReferenceWindow, corridor: Corridor | None = None
    ) -> None:
        """Set the target, and warm start: shift the last plan, or hold the reference's inputs."""
        self._here = self._anywhere
        if corridor is not None:
            self._here = self._within
            half_spaces = self._here.workspace.half_spaces
            half_spaces.take(corridor, stamp_ns=state.stamp_ns, step=self._step)
        if window is not self._window:  # one serves several ticks
            self._window, self._samples = window, packed(window)
        stamp_ns, (last_ns, last_cost) = state.stamp_ns, self._last
        recovering = 0 <= self._flips_until_ns - stamp_ns <= _RECOVERING_NS
        self._elapsed_ns = stamp_ns - window.stamp_ns
        self._cost, self._iterations, flips = sqp.begin(
            elapsed_ns=self._elapsed_ns,
            samples=self._samples,
            prediction=state.prediction,
            last=((stamp_ns - last_ns) * 1e-9 / self._step, last_cost),
            recovering=recovering,
            settings=self._settings,
            workspace=self._here.workspace,
            stages=self._here.stages,
        )
        if flips:
            self._flips_until_ns = stamp_ns + _RECOVERING_NS
        self._state, self._flipping = state, recovering or flips
        # What is rolled out for its cost has been linearised on the way.
        self._linearised = True

    def linearise(self) -> HorizonStages:
        """Return the QP in the change of the present iterate."""
        if not self._linearised:
            cost = sqp.relinearise(
                elapsed_ns=self._elapsed_ns,
                samples=self._samples,
                prediction=self._state.prediction,
                is_flipping=self._flipping,
                settings=self._settings,
                workspace=self._here.workspace,
                stages=self._here.stages,
            )
            if self._here.limits.rows > 0:  # at other prices
                self._cost = cost
        self._linearised = False
        return self._here.stages

    def line_search(self, inputs: Array, states: Array) -> bool:
        """Take the longest step that lowers the true cost; return whether to leave it at that."""
        count, stamp_ns = self._steps + 1, self._state.stamp_ns
        commands = np.empty((self._steps * SUBSTEPS, INPUT_SIZE))
        p_WB, R_WB = np.empty((count, 3)), np.empty((count, 3, 3))
        reached = sqp.line_search(
            elapsed_ns=self._elapsed_ns,
            samples=self._samples,
            prediction=self._state.prediction,
            change=inputs,
            cost=self._cost,
            settings=self._settings,
            workspace=self._here.workspace,
            inputs=commands,
            p_WB=p_WB,
            R_WB=R_WB,
        )
        self._plan = Plan(
            stamp_ns=stamp_ns,
            step=self._step,
            input_step=self._step / SUBSTEPS,
            inputs=commands,
            p_WB=p_WB,
            R_WB=R_WB,
            speeds=self._here.workspace.progress.plan.copy(),
        )
        converged = not reached < _CONVERGED * self._cost
        self._cost, self._iterations = reached, self._iterations - 1
        self._last = stamp_ns, reached
        return converged or self._iterations == 0

    def plan(self) -> Plan:
        """Return the plan of the last line search, in arrays of its own."""
        return self._plan
