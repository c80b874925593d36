# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A course as a nonlinear program by direct multiple shooting, solved with IPOPT.

Each leg has a fixed number of steps of equal, free duration. Fixed numbers replace complementarity
constraints of Foehn et al. (2021), which let the optimiser choose the step of a gate. The duration
of a leg is a state of every node, so that the constraints couple only neighbours.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.racing.planning.casadi_module import casadi
from quad_mpc_ros.extras.racing.planning.legs import GATE_NODE_GAP, CourseLeg, Goal

MIN_LEG_DURATION, MAX_LEG_DURATION = 0.02, 60.0  # s, of a leg

_Rows = tuple[Any, Array, Array]
"""Constraints: expressions (n,), lower and upper bounds (n,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Nodes:
    """A motion at nodes: states (K + 1, nx), inputs (K, nu) held between them.

    ``durations`` (legs,) [s] and numbers of steps ``counts`` (legs,) of the legs.
    """

    states: Array
    inputs: Array
    durations: Array
    counts: tuple[int, ...]

    @property
    def steps(self) -> Array:
        """Length of each step (K,) [s]."""
        return np.repeat(self.durations / self.counts, self.counts)

    @property
    def ends(self) -> Array:
        """The node at which each leg ends (legs,)."""
        return np.cumsum(self.counts)

    @property
    def times(self) -> Array:
        """Time of each node (K + 1,) [s]."""
        return np.append(0.0, np.cumsum(self.steps))


@dataclass(frozen=True, kw_only=True, eq=False)
class Dynamics:
    """Dynamics and bounds for the transcription.

    CasADi functions of a state (nx,), inputs (nu,) and a time [s]: ``step(x, u, h)`` is the state
    after ``h``, ``path(x, u, h)`` (nc,) is bounded over a step; ``acceleration(x, u)`` (3,) is in
    the world. States, inputs and path have bounds (lower, upper). Finite values of ``first`` and
    ``last`` fix the first state and states at rest. ``scale`` (nu,) are natural sizes of the
    inputs, ``smoothing`` [s] is the cost of a squared change of an input, relative to its size.
    """

    step: Any
    acceleration: Any
    path: Any
    state_bounds: tuple[Array, Array]
    input_bounds: tuple[Array, Array]
    path_bounds: tuple[Array, Array]
    first: Array
    last: Array
    scale: Array
    smoothing: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """Result of IPOPT: the nodes, whether they are optimal, status and iterations."""

    nodes: Nodes
    optimal: bool
    status: str
    iterations: int


def solve(
    legs: Sequence[CourseLeg],
    dynamics: Dynamics,
    guess: Nodes,
    *,
    name: str,
    most_iterations: int,
) -> Solved:
    """Return the motion with the smallest weighted time along the legs, from an initial guess."""
    ca = casadi()
    nx, nu = len(dynamics.first), len(dynamics.scale)
    steps, ends = len(guess.inputs), guess.ends
    stage = ca.MX.sym("stage", nx + 1 + nu, steps)
    final = ca.MX.sym("final", nx + 1)
    states = ca.horzcat(stage[: nx + 1, :], final)
    inputs = stage[nx + 1 :, :]
    rows = [*_motion_rows(dynamics, states, inputs, counts=guess.counts)]
    for leg, end in zip(legs, ends.tolist(), strict=True):
        if leg.goal is not None:
            rows += _goal_rows(leg.goal, states, end)
    constraints = ca.vertcat(*(ca.vec(expressions) for expressions, _, _ in rows))
    cost = sum(leg.weight * states[nx, int(end) - 1] for leg, end in zip(legs, ends, strict=True))
    change = (inputs[:, 1:] - inputs[:, :-1]) / ca.DM(dynamics.scale)
    lower, upper = _bounds(legs, dynamics, guess)
    options: dict[str, Any] = {
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": most_iterations,
            "tol": 1e-4,
            "constr_viol_tol": 1e-6,
            "mu_init": 1e-2,
        },
    }
    variables = ca.vertcat(ca.vec(stage), final)
    cost += dynamics.smoothing * ca.sumsqr(change)
    solver = ca.nlpsol(name, "ipopt", {"x": variables, "f": cost, "g": constraints}, options)
    least, most = (np.concatenate(bounds) for bounds in list(zip(*rows, strict=True))[1:])
    with _interruptible():
        found = solver(x0=_packed(guess), lbx=lower, ubx=upper, lbg=least, ubg=most)
    stats = solver.stats()
    return Solved(
        nodes=_unpacked(np.array(found["x"]).ravel(), guess),
        optimal=bool(stats["success"]),
        status=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
    )


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end if Ctrl-C was pressed.

    CasADi checks for Python's signals, stops, and may return a result nevertheless.
    """
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or before is not signal.default_int_handler:
        yield
        return
    pressed = threading.Event()

    def press(number: int, frame: object) -> None:
        pressed.set()
        signal.default_int_handler(number, None)

    signal.signal(signal.SIGINT, press)
    try:
        yield
    except SystemError:  # a result together with an exception
        if not pressed.is_set():
            raise
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed.is_set():
        raise KeyboardInterrupt


def _unpacked(variables: Array, like: Nodes) -> Nodes:
    """Return the nodes in the variables of the program, with the shape of ``like``."""
    steps, nx = len(like.inputs), like.states.shape[1]
    rows = variables[: -(nx + 1)].reshape(steps, -1)
    states = np.vstack((rows[:, : nx + 1], variables[-(nx + 1) :]))
    return Nodes(
        states=states[:, :nx],
        inputs=rows[:, nx + 1 :],
        durations=states[like.ends - 1, nx],
        counts=like.counts,
    )


def _packed(nodes: Nodes) -> Array:
    durations = np.repeat(nodes.durations, nodes.counts)
    rows = np.column_stack((nodes.states[:-1], durations, nodes.inputs))
    return np.concatenate((rows.ravel(), nodes.states[-1], durations[-1:]))


def _motion_rows(
    dynamics: Dynamics, states: Any, inputs: Any, *, counts: tuple[int, ...]
) -> Iterator[_Rows]:
    """Yield the dynamics between nodes and the path constraints."""
    ca = casadi()
    nx, steps = len(dynamics.first), sum(counts)
    x, duration, share = ca.SX.sym("x", nx), ca.SX.sym("T"), ca.SX.sym("s")
    u = ca.SX.sym("u", len(dynamics.scale))
    after = ca.vertcat(dynamics.step(x, u, duration * share), duration)
    move = ca.Function("move", [ca.vertcat(x, duration), u, share], [after]).map(steps)
    shares = np.concatenate([np.full(count, 1.0 / count) for count in counts])
    gaps = move(states[:, :-1], inputs, ca.DM(shares).T) - states[:, 1:]
    # Stage by stage, for a narrow factorisation. The duration is not continuous between legs.
    legs_end = set(np.cumsum(counts)[:-1].tolist())
    bounded = None
    if len(dynamics.path_bounds[0]):
        lengths = states[nx, :-1] * ca.DM(shares).T
        bounded = dynamics.path.map(steps)(states[:nx, :-1], inputs, lengths)
    for k in range(steps):
        kept = nx if k + 1 in legs_end else nx + 1
        yield gaps[:kept, k], np.zeros(kept), np.zeros(kept)
        if bounded is not None:
            yield bounded[:, k], *dynamics.path_bounds


def _goal_rows(goal: Goal, states: Any, end: int) -> Iterator[_Rows]:
    """Yield the constraints at the end of a leg; a gate is passed from the front."""
    yield goal.expressions(states[0:3, end], states[3:6, end]), goal.lower, goal.upper
    if goal.depth is None:
        return
    gap, free = np.array([GATE_NODE_GAP]), np.array([np.inf])
    yield goal.depth(states[0:3, end - 1]), -free, -gap
    if end + 1 < states.shape[1]:
        yield goal.depth(states[0:3, end + 1]), gap, free


def _bounds(legs: Sequence[CourseLeg], dynamics: Dynamics, guess: Nodes) -> tuple[Array, Array]:
    steps, sides = len(guess.inputs), []
    for side, length in enumerate((MIN_LEG_DURATION, MAX_LEG_DURATION)):
        state = np.tile(np.append(dynamics.state_bounds[side], length), (steps + 1, 1))
        _fix(state, 0, dynamics.first)
        for leg, end in zip(legs, guess.ends.tolist(), strict=True):
            if leg.at_rest:
                _fix(state, end, dynamics.last)
        rows = np.column_stack((state[:-1], np.tile(dynamics.input_bounds[side], (steps, 1))))
        sides.append(np.concatenate((rows.ravel(), state[-1])))
    return sides[0], sides[1]


def _fix(states: Array, node: int, values: Array) -> None:
    given = np.isfinite(values)
    states[node, : len(values)][given] = values[given]
