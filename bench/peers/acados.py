# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""acados as a peer: one real-time iteration with HPIPM on the same problem.

R. Verschueren et al., "acados: a modular open-source framework for fast embedded optimal
control", Mathematical Programming Computation, 2021. The wheel ``comma-deps-acados`` brings its
libraries, its Python interface and a CasADi; acados generates and compiles a C solver.

State (p_WB, v_WB_W, q_WB_xyzw), input (throttle, w_WB_B), the rigid body with the drag and the
thrust curve of the vehicle. The errors are those of the manifold formulation, Log(R_r' R) for the
attitude; the reference of a stage is its parameter vector, so that one call sets it. Limits of
tilt and speed are soft constraints of the same sizes, with one slack each.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import fcntl
import functools
import hashlib
import importlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers.peer import (
    SOFT_LIMITS,
    Effort,
    NewPeer,
    PeerKind,
    PeerUnavailableError,
    soft_limits_of,
)

from quad_mpc_ros.configuration import per_axis
from quad_mpc_ros.configuration.compilation import cache_folder
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.reference_window import sample
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.ocp.limits import SPEED_MARGIN, TILT_MARGIN

STATE_SIZE, INPUT_SIZE = 10, 4
FREE = 1e4
"""A bound that nothing reaches."""
REFERENCE_SIZE = 3 + 3 + 9 + INPUT_SIZE
"""A stage's reference: p_WB, v_WB_W, R_WB row by row, input."""

# One step of order 4 a stage. At rates up to their bounds it was measured to err less in position
# and velocity than four of the manifold formulation's substeps; more would only cost acados time.
_RUNGE_KUTTA_STEPS = 1
# Of breaking a soft limit, per rad and per m/s. The manifold formulation computes them for each
# problem; these are its values in all but one of twenty steps of the square. The tilt has two
# rows, the speed one. In the order of SOFT_LIMITS.
_PRICES = np.array([100.0, 60.0])
_SQUARES = _PRICES * np.array([1.0, 1.0 / 6.0])
_SOLVED = 0  # acados' status
_LIBRARIES = ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so", "libacados.so")
_TINY = 1e-24  # keeps the derivative of a length finite at zero
_SOFT = 1e-3  # m/s^2, and that of its root


class AcadosPeer:
    """Sets state and reference through acados' Python interface and calls its C solver once.

    It samples the reference as the manifold formulation does: states at the stages' ends, inputs
    at their middles.
    """

    def __init__(self, config: MpcConfig, solver: Any) -> None:
        self._vehicle = config.vehicle()
        self._solver = solver
        self._steps, self._step = config.horizon_steps, config.horizon_step
        half_steps = np.arange(1, 2 * self._steps + 1)
        self._offsets_ns = np.rint(config.horizon_step * 0.5e9 * half_steps).astype(np.int64)
        self._references = np.zeros((self._steps + 1, REFERENCE_SIZE))
        self._u_min = np.array([config.throttle_min, *(-w for w in config.omega_max)])
        self._u_max = np.array([config.throttle_max, *config.omega_max])
        self._limits, self._soft_limits = config.limits, soft_limits_of(config)
        self._q_xyzw: Array | None = None
        self._status = _SOLVED
        solver.reset()

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the first input of one real-time iteration; None when HPIPM failed."""
        x = self._state(odometry)
        self._set_references(odometry.stamp_ns, window, p_WB=x[:3])
        solver = self._solver
        if self._q_xyzw is None:
            self._start_from(x)
        self._q_xyzw = x[6:]
        solver.set(0, "lbx", x)
        solver.set(0, "ubx", x)
        self._status = solver.solve()
        if self._status != _SOLVED:
            return None
        u = solver.get(0, "u")
        return CommandSample(stamp_ns=odometry.stamp_ns, throttle=float(u[0]), w_WB_B=u[1:])

    def effort(self) -> Effort:
        """Return HPIPM's iterations and the time of the whole call of the C solver."""
        return Effort(
            solved=self._status == _SOLVED,
            iterations=int(np.sum(self._solver.get_stats("qp_iter"))),
            solve_time=float(self._solver.get_stats("time_tot")[0]),
        )

    def inputs(self) -> Array:
        """Return the planned inputs (N, 4)."""
        return np.array([self._solver.get(stage, "u") for stage in range(self._steps)])

    def _state(self, odometry: OdometrySample) -> Array:
        """Return the state of acados' model, the quaternion with the sign of the last one."""
        q_xyzw = odometry.q_WB_xyzw
        v_WB_W = so3.rotation_from_quaternion_xyzw(q_xyzw) @ odometry.v_WB_B
        if self._q_xyzw is not None and q_xyzw @ self._q_xyzw < 0.0:
            q_xyzw = -q_xyzw
        return np.concatenate((odometry.p_WB, v_WB_W, q_xyzw))

    def _start_from(self, x: Array) -> None:
        """Begin the first iteration at the state held, with the inputs of the reference."""
        for stage in range(self._steps + 1):
            self._solver.set(stage, "x", x)
        for stage in range(self._steps):
            self._solver.set(stage, "u", self._references[stage, 15:])

    def _set_references(self, stamp_ns: int, window: ReferenceWindow, *, p_WB: Array) -> None:
        points = sample(window, stamp_ns + self._offsets_ns)
        ends, middles = slice(1, None, 2), slice(0, None, 2)
        references = self._references
        references[1:, 0:3] = points.p_WB[ends]
        references[1:, 3:6] = points.v_WB_W[ends]
        references[1:, 6:15] = points.R_WB[ends].reshape(-1, 9)

        if self._soft_limits:
            self._set_limits(references[1:], p_WB)

        thrust = self._vehicle.mass * self._vehicle.specific_thrust(
            a_WB_W=points.a_WB_W[middles],
            v_WB_W=points.v_WB_W[middles],
            R_WB=points.R_WB[middles],
        )
        throttles = [self._vehicle.nearest_throttle(t) for t in thrust.tolist()]
        inputs = np.column_stack((throttles, points.w_WB_B[middles]))
        references[:-1, 15:] = np.clip(inputs, self._u_min, self._u_max)
        for stage, reference in enumerate(references):
            self._solver.set(stage, "p", reference)

    def _set_limits(self, references: Array, p_WB: Array) -> None:
        """Draw a far reference (N, ...) near, and set what the limits allow beyond its own."""
        away = p_WB - references[0, 0:3] + self._step * references[0, 3:6]
        far = np.array([np.hypot(away[0], away[1])] * 2 + [abs(away[2])])
        distance = self._limits.position_error_max
        references[:, 0:3] += (1.0 - distance / np.maximum(far, distance)) * away
        most = []
        if "tilt_max" in self._soft_limits:
            own = np.arccos(np.clip(references[:, 14], -1.0, 1.0))
            tilt = np.maximum(self._limits.tilt_max, own + TILT_MARGIN)
            most += 2 * [np.where(tilt < 0.5 * np.pi, np.sin(tilt), FREE)]
        if "speed_max" in self._soft_limits:
            own = np.linalg.norm(references[:, 3:6], axis=1)
            most.append(np.maximum(self._limits.speed_max, own + SPEED_MARGIN))
        for stage, bound in enumerate(np.stack(most, axis=1), start=1):
            self._solver.constraints_set(stage, "uh", bound)
            self._solver.constraints_set(stage, "lh", -bound)


class AcadosController:
    """The peer behind the interface of all controllers.

    It flies with ``--controller peers.acados:AcadosController`` where ``bench`` is in the search
    path. Lags, delay and disturbance are left out of its model. Where HPIPM fails, the last
    command is repeated, with the inputs of the reference as the next guess.
    """

    def __init__(self, config: MpcConfig) -> None:
        lags = dict.fromkeys(("rate_time_constant", "thrust_time_constant", "input_delay"), 0.0)
        self._config = dataclasses.replace(config, **lags, estimate_disturbance=False)
        self._solver = _solver_of(self._config)
        self.reset()

    def reset(self) -> None:
        """Discard the last solution."""
        self._peer = AcadosPeer(self._config, self._solver)
        self._last: CommandSample | None = None

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample:
        """Return the first input of one real-time iteration."""
        command = self._peer.step(odometry, window)
        if command is None:
            command, peer = self._last, AcadosPeer(self._config, self._solver)
            if command is None:
                raise RuntimeError("HPIPM found no first solution")
            self._peer = peer
        self._last = command
        return command


@functools.cache
def _solver_of(config: MpcConfig) -> Any:
    """Return the solver of a configuration, compiled once in the compile cache."""
    digest = hashlib.sha256(repr(config).encode()).hexdigest()[:16]
    folder = Path(cache_folder() or tempfile.mkdtemp(), f"acados-{digest}")
    folder.mkdir(exist_ok=True)
    built = folder / "built"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # other workers need the same solver
        solver = build_solver(config, folder, compile_it=not built.exists())
        built.touch()
    return solver


def build_solver(
    config: MpcConfig, folder: Path, *, converge: bool = False, compile_it: bool = True
) -> Any:
    """Return an ``AcadosOcpSolver`` of a configuration, compiled in ``folder``.

    It takes one real-time iteration a call, or with ``converge`` as many SQP iterations as it
    needs. Without ``compile_it`` the folder has been compiled. Raises
    :class:`PeerUnavailableError` when acados is not installed, cannot compile, or
    has no model of what the configuration asks for.
    """
    _require_plain_model(config)
    acados = _acados()
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "build.log"
    try:
        # Its generator changes the directory and does not always come back.
        with (
            _environment(_source_tree(acados, folder)),
            contextlib.chdir(folder),
            _output_to(log),
        ):
            template = importlib.import_module("acados.acados_template")
            problem = _problem(template, config, folder, converge=converge)
            return template.AcadosOcpSolver(
                problem,
                json_file=str(folder / f"{problem.model.name}.json"),
                build=compile_it,
                generate=compile_it,
                verbose=True,
            )
    except Exception as error:  # whatever its generator and compiler raise
        raise PeerUnavailableError(
            f"acados could not build its solver ({type(error).__name__}: {error}); {_last(log)}"
        ) from error


def _require_plain_model(config: MpcConfig) -> None:
    wanted = [
        name
        for name in (
            "rate_time_constant",
            "thrust_time_constant",
            "input_delay",
            "estimate_disturbance",
        )
        if getattr(config, name)
    ]
    if wanted:
        raise PeerUnavailableError(
            f"the acados peer has no {', '.join(wanted)}: --set mpc.{wanted[0]}=0, or false"
        )


def _acados() -> Path:
    """Return the folder of the installed package."""
    try:
        package = importlib.import_module("acados")
        importlib.import_module("casadi")
    except ImportError as error:
        raise PeerUnavailableError(
            f"{error}: pip install 'quad_mpc_ros[bench]' (x86_64 Linux, Python 3.11 or 3.12)"
        ) from error
    missing = [tool for tool in ("gcc", "make") if shutil.which(tool) is None]
    if missing:
        raise PeerUnavailableError(
            f"acados compiles its solver and needs {' and '.join(missing)}: "
            "apt install build-essential"
        )
    return Path(str(package.__file__)).parent


def _source_tree(acados: Path, folder: Path) -> dict[str, str]:
    """Lay out what acados' generator looks for; return the variables that lead it there.

    The wheel lacks ``link_libs.json``, and nothing is written into an installed package.
    """
    root = folder / "acados"
    libraries = root / "lib"
    libraries.mkdir(parents=True, exist_ok=True)
    links = {root / "include": acados / "install" / "include"}
    for library in (acados / "install" / "lib").iterdir():
        links[libraries / library.name] = library
    for link, target in links.items():
        if not link.is_symlink():
            link.symlink_to(target)
    link_flags = {"openmp": "", "qpoases": "-lqpOASES_e", "hpmpc": "", "osqp": ""}
    (libraries / "link_libs.json").write_text(json.dumps(link_flags), encoding="utf-8")
    for name in _LIBRARIES:
        # Found by their names from now on, without LD_LIBRARY_PATH.
        ctypes.CDLL(str(acados / "install" / "lib" / name), mode=ctypes.RTLD_GLOBAL)
    return {
        "ACADOS_SOURCE_DIR": str(root),
        "ACADOS_PYTHON_INTERFACE_PATH": str(acados / "acados_template"),
        "TERA_PATH": str(acados / "install" / "bin" / "t_renderer"),
    }


def _problem(template: Any, config: MpcConfig, folder: Path, *, converge: bool) -> Any:
    casadi = importlib.import_module("casadi")
    problem = template.AcadosOcp()
    problem.code_export_directory = str(folder / "code")
    problem.dims.N = config.horizon_steps
    model = problem.model
    model.name = f"quadrotor_{config.horizon_steps}" + ("_sqp" if converge else "")
    model.x = casadi.SX.sym("x", STATE_SIZE)
    model.u = casadi.SX.sym("u", INPUT_SIZE)
    model.p = casadi.SX.sym("p", REFERENCE_SIZE)
    model.f_expl_expr = _dynamics(casadi, model.x, model.u, config.vehicle())
    problem.parameter_values = np.zeros(REFERENCE_SIZE)
    _set_cost(casadi, problem, config)
    _set_bounds(problem, config)
    _set_limits(casadi, problem, config)
    _set_options(problem.solver_options, config, converge=converge)
    return problem


def _dynamics(casadi: Any, x: Any, u: Any, vehicle: Vehicle) -> Any:
    v, q = x[3:6], x[6:10]
    a, b, c = vehicle.thrust_curve
    thrust = vehicle.motor_count * ((a * u[0] + b) * u[0] + c)
    gravity = casadi.vertcat(0.0, 0.0, -vehicle.gravity)
    R, drag = _rotation(casadi, q), casadi.vertcat(*per_axis(vehicle.drag))
    push, air = thrust / vehicle.mass, drag * v
    is_isotropic = vehicle.translational_lift == 0.0 and not any(per_axis(vehicle.rotor_drag))
    if not (is_isotropic and len(set(per_axis(vehicle.drag))) == 1):
        v_B, rotors = R.T @ v, casadi.vertcat(*per_axis(vehicle.rotor_drag))
        drag = drag + rotors * casadi.sqrt(casadi.fmax(push, _SOFT) / vehicle.gravity)
        push += vehicle.translational_lift * (v_B[0] ** 2 + v_B[1] ** 2)
        air = R @ (drag * v_B)
    acceleration = push * R[:, 2] + gravity - air
    vector, scalar, w = q[:3], q[3], u[1:]
    turn = casadi.vertcat(
        0.5 * (scalar * w + casadi.cross(vector, w)), -0.5 * casadi.dot(vector, w)
    )
    return casadi.vertcat(v, acceleration, turn)


def _rotation(casadi: Any, q: Any) -> Any:
    """Return the rotation of a quaternion x, y, z, w, times its squared length."""
    x, y, z, w = (q[i] for i in range(4))
    return casadi.vertcat(
        casadi.horzcat(w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)),
        casadi.horzcat(2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)),
        casadi.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z),
    )


def _attitude_error(casadi: Any, q: Any, R_reference: Any) -> Any:
    """Return Log(R_r' R(q)): with s = vee(E - E') and tan(angle / 2) = |s| / (1 + trace E)."""
    E = R_reference.T @ _rotation(casadi, q)
    sine = casadi.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])
    length = casadi.sqrt(casadi.dot(sine, sine) + _TINY)
    return 2.0 * casadi.atan2(length, casadi.dot(q, q) + casadi.trace(E)) * sine / length


def _set_cost(casadi: Any, problem: Any, config: MpcConfig) -> None:
    """State the paper's cost of the states 1 to N and the inputs 0 to N - 1.

    acados multiplies what is not terminal by the time step.
    """
    model, cost, steps = problem.model, problem.cost, config.horizon_steps
    x, u, p = model.x, model.u, model.p
    R_reference = casadi.reshape(p[6:15], 3, 3).T
    state_error = casadi.vertcat(
        x[0:3] - p[0:3], x[3:6] - p[3:6], _attitude_error(casadi, x[6:10], R_reference)
    )
    input_error = u - p[15:19]
    Q, R, step = np.diag(config.Q), np.diag(config.R), config.horizon_step
    both = np.zeros((13, 13))
    both[:9, :9], both[9:, 9:] = Q, R
    cost.cost_type = cost.cost_type_0 = cost.cost_type_e = "NONLINEAR_LS"
    model.cost_y_expr_0, model.cost_y_expr_e = input_error, state_error
    model.cost_y_expr = casadi.vertcat(state_error, input_error)
    cost.W_0, cost.W, cost.W_e = R / step, both / step, config.terminal_weight * Q
    cost.yref_0, cost.yref, cost.yref_e = np.zeros(4), np.zeros(13), np.zeros(9)
    problem.solver_options.tf = steps * step


def _set_bounds(problem: Any, config: MpcConfig) -> None:
    bounds = problem.constraints
    bounds.lbu = np.array([config.throttle_min, *(-w for w in config.omega_max)])
    bounds.ubu = np.array([config.throttle_max, *config.omega_max])
    bounds.idxbu = np.arange(INPUT_SIZE)
    bounds.x0 = np.array([0.0] * 9 + [1.0])


def _set_limits(casadi: Any, problem: Any, config: MpcConfig) -> None:
    """State tilt and speed as soft constraints; the bounds are set with each reference.

    The tilt as the components of up along the body's x and y axes: a square about the disc, and
    not its angle, which has no gradient where the vehicle is level.
    """
    used = soft_limits_of(config)
    if not used:
        return
    x, bounds, cost = problem.model.x, problem.constraints, problem.cost
    up = _rotation(casadi, x[6:10])[2, :]
    speed = casadi.sqrt(casadi.dot(x[3:6], x[3:6]) + _TINY)
    rows = {"tilt_max": [up[0], up[1]], "speed_max": [speed]}
    expression = casadi.vertcat(*(row for name in used for row in rows[name]))
    problem.model.con_h_expr = problem.model.con_h_expr_e = expression
    of = [SOFT_LIMITS.index(name) for name in used for _ in rows[name]]
    count, free = len(of), np.full(len(of), FREE)
    bounds.lh = bounds.lh_e = -free
    bounds.uh = bounds.uh_e = free
    bounds.idxsh = bounds.idxsh_e = np.arange(count)
    prices, squares, step = _PRICES[of], _SQUARES[of], config.horizon_step
    # HPIPM has a slack downwards as well, and needs a price for it.
    cost.zl = cost.zu = prices / step
    cost.Zl = cost.Zu = squares / step
    cost.zl_e = cost.zu_e = prices
    cost.Zl_e = cost.Zu_e = squares


def _set_options(options: Any, config: MpcConfig, *, converge: bool) -> None:
    options.nlp_solver_type = "SQP" if converge else "SQP_RTI"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    options.hessian_approx = "GAUSS_NEWTON"
    options.integrator_type = "ERK"
    options.sim_method_num_stages = 4
    options.sim_method_num_steps = _RUNGE_KUTTA_STEPS
    options.qp_solver_warm_start = 1
    options.print_level = 0
    if converge:
        options.nlp_solver_max_iter = 200
        options.qp_solver_iter_max = 200


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _output_to(log: Path) -> Iterator[None]:
    """Send what Python and the compiler print to a file: their descriptors, not only sys's."""
    sys.stdout.flush()
    sys.stderr.flush()
    with log.open("wb") as file, contextlib.ExitStack() as restored:
        for descriptor in (1, 2):
            kept = os.dup(descriptor)
            restored.callback(os.close, kept)
            restored.callback(os.dup2, kept, descriptor)
            os.dup2(file.fileno(), descriptor)
        restored.callback(sys.stdout.flush)
        yield


def _last(log: Path) -> str:
    """Return the last words of a log."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.exists() else []
    said = [line.strip() for line in lines if line.strip()]
    return f"it said: {said[-1]}" if said else "it said nothing"


def _made(config: MpcConfig, folder: Path) -> NewPeer:
    return partial(AcadosPeer, config, build_solver(config, folder))


PEER = PeerKind(
    title="acados SQP_RTI + HPIPM",
    solver="its C code",
    description="the same problem in C: one real-time iteration per step, partial condensing, "
    "HPIPM, one Runge-Kutta step per stage. The step includes the Python interface.",
    make=_made,
    swept=True,
    package="comma-deps-acados",
)
