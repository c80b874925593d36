"""Replanning of a part of a race in flight, from a state of the present plan.

The first guess is the present plan through the former gates.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.live_race import ReplanRequest
from quad_mpc_ros.extras.racing.planning.first_guess import MIN_STEPS, PosedMotion
from quad_mpc_ros.extras.racing.planning.legs import legs_of
from quad_mpc_ros.extras.racing.planning.model import F, Model, P, Q, V, W
from quad_mpc_ros.extras.racing.planning.race_plan import (
    dynamics_of,
    equations_of,
    guess_of,
    lowest_of,
    table_of,
)
from quad_mpc_ros.extras.racing.planning.settings import PlanSettings
from quad_mpc_ros.extras.racing.planning.transcription import MIN_LEG_DURATION, solve
from quad_mpc_ros.references.motion_table import MotionTable, PlannedMotion

_MAX_ITERATIONS = 150
_THRUST_ITERATIONS = 8  # for the thrust, on which the drag of the rotors depends slightly


def planned_part(request: ReplanRequest) -> MotionTable:
    """Return the time-optimal plan for a part of a race.

    Position, velocity, attitude, body rates and a lagging thrust are those of the present plan at
    the start and, unless the race ends there, at the end. Raises :class:`UserError` if no plan is
    found.
    """
    settings = PlanSettings.of(request.motion.planned_with)
    legs = legs_of(request.part, margin=settings.gate_margin, radius=settings.radius)
    model = equations_of(settings)
    guess = guess_of(_posed(request, model, settings), model, settings.vehicle)
    dynamics = dynamics_of(model, first=guess.states[0], lowest=lowest_of(request.part))
    if request.rejoin is not None:
        last = guess.states[-1].copy()
        last[P] = np.nan  # defined by the last leg
        last[Q.start + int(np.abs(last[Q]).argmax())] = np.nan  # the length is 1 as it is
        dynamics = dataclasses.replace(dynamics, last=last)
    solved = solve(legs, dynamics, guess, name="replan", most_iterations=_MAX_ITERATIONS)
    if not solved.optimal:
        raise UserError(f"no plan found ({solved.status} after {solved.iterations} iterations)")
    rests = False, request.rejoin is None
    return table_of(model, solved.nodes, settings, source="the new plan", rests=rests)


def _posed(request: ReplanRequest, model: Model, settings: PlanSettings) -> PosedMotion:
    """Return the present motion at the nodes of the part."""
    motion, begin = request.motion, request.leave_seconds
    durations = np.maximum(np.diff(request.ends, prepend=begin), 2.0 * MIN_LEG_DURATION)
    counts = np.maximum(MIN_STEPS, np.ceil(durations / settings.step)).astype(int)
    times = begin + np.append(0.0, np.cumsum(np.repeat(durations / counts, counts)))
    times[-1] = request.ends[-1]
    samples = PlannedMotion(motion).at(np.round(1e9 * times).astype(np.int64).tolist())
    seconds = motion.seconds - motion.seconds[0]
    w = [np.interp(times, seconds, column) for column in motion.w_WB_B.T]
    q = samples.q_WB_xyzw[:, [3, 0, 1, 2]]
    flips = np.sign(np.sum(q[:-1] * q[1:], axis=1))
    q[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips))[:, None]
    states = np.column_stack((samples.p_WB, samples.v_WB_W, q, *w))
    return PosedMotion(
        p=states[:, P],
        v=states[:, V],
        q_wxyz=states[:, Q],
        w=states[:, W],
        thrust=_thrust(model, states, samples.a_WB_W, settings.vehicle.gravity),
        durations=durations,
        counts=tuple(counts.tolist()),
    )


def _thrust(model: Model, states: Array, a_WB_W: Array, gravity: float) -> Array:
    """Return the thrusts over mass (n,) [m/s^2] for the accelerations of states (n, 13)."""
    w, x, y, z = states[:, Q].T
    up = np.column_stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))
    thrust = np.einsum("ni,ni->n", up, a_WB_W) + gravity * up[:, 2]
    if model.nx > F.start:  # drag of body and rotors depends on the thrust
        acceleration = model.acceleration.map(len(states))
        inputs = np.tile(model.hover, (len(states), 1)).T
        for _ in range(_THRUST_ITERATIONS):
            found = acceleration(np.column_stack((states, thrust)).T, inputs)
            thrust += np.einsum("ni,ni->n", up, a_WB_W - np.array(found).T)
    return np.asarray(thrust)
