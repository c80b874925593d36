"""The equations of motion against physics and an integrator of another kind."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from fixtures.plant_motion import integrate, rate
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.state import Input, State, boxminus
from quad_mpc_ros.control.model.vehicle import Vehicle

BOTH = pytest.mark.parametrize("dynamics", ["paper", "rigid_body"])


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle()


@pytest.fixture(scope="module")
def gliding() -> Vehicle:
    """A vehicle without thrust at throttle 0."""
    return Vehicle(thrust_curve=(1.87953563, 2.79829004, 0.0))


def at_rest(R_WB: Array | None = None) -> State:
    return State(p_WB=np.zeros(3), v_WB_B=np.zeros(3), R_WB=np.eye(3) if R_WB is None else R_WB)


def flown(
    x: State, u: Input, vehicle: Vehicle, *, dynamics: str, duration: float, steps: int
) -> State:
    for _ in range(steps):
        x = integrate(x, u, vehicle, dynamics=dynamics, duration=duration / steps)
    return x


def hovering(vehicle: Vehicle, rates: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Input:
    return Input(throttle=vehicle.hover_throttle, w_WB_B=np.array(rates))


@BOTH
def test_hover_is_an_equilibrium(dynamics: str, vehicle: Vehicle) -> None:
    heading = Rotation.from_euler("z", 1.0).as_matrix()
    held = rate(at_rest(heading), hovering(vehicle), vehicle, dynamics=dynamics)
    assert_allclose(held, np.zeros(9), atol=1e-14)


@BOTH
def test_nose_down_accelerates_forwards(dynamics: str, vehicle: Vehicle) -> None:
    x = at_rest()
    x = flown(
        x, hovering(vehicle, (0.0, 1.0, 0.0)), vehicle, dynamics=dynamics, duration=0.3, steps=10
    )
    nose = x.R_WB[:, 0]
    assert nose[2] < 0.0
    x = flown(x, hovering(vehicle), vehicle, dynamics=dynamics, duration=0.5, steps=10)
    assert x.v_WB_W[0] > 0.5
    assert x.p_WB[0] > 0.1
    assert abs(x.v_WB_W[1]) < 1e-12


@BOTH
def test_left_side_up_accelerates_to_the_right(dynamics: str, vehicle: Vehicle) -> None:
    x = at_rest()
    for rates in ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        x = flown(x, hovering(vehicle, rates), vehicle, dynamics=dynamics, duration=0.3, steps=10)
    assert x.v_WB_W[1] < -0.1


@BOTH
def test_quarter_yaw_turns_the_nose_from_east_to_north(dynamics: str, vehicle: Vehicle) -> None:
    u = hovering(vehicle, (0.0, 0.0, math.pi / 2.0))
    x = flown(at_rest(), u, vehicle, dynamics=dynamics, duration=1.0, steps=20)
    assert_allclose(x.R_WB[:, 0], [0.0, 1.0, 0.0], atol=1e-14)
    assert_allclose(x.p_WB, np.zeros(3), atol=1e-14)


@BOTH
def test_throttle_up_climbs_and_throttle_down_sinks(dynamics: str, vehicle: Vehicle) -> None:
    for change in (0.01, -0.01):
        u = Input(throttle=vehicle.hover_throttle + change, w_WB_B=np.zeros(3))
        x = flown(at_rest(), u, vehicle, dynamics=dynamics, duration=1.0, steps=10)
        assert math.copysign(1.0, change) * x.p_WB[2] > 0.05


def test_full_throttle_lifts_by_the_excess_of_thrust(vehicle: Vehicle) -> None:
    lifted = rate(at_rest(), Input(throttle=1.0, w_WB_B=np.zeros(3)), vehicle)
    assert lifted[5] == pytest.approx(18.6907 / 0.396893 - 9.81, abs=1e-3)


@BOTH
def test_free_fall_without_drag(dynamics: str, gliding: Vehicle) -> None:
    body = dataclasses.replace(gliding, drag=0.0)
    tilted = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    x = State(p_WB=np.array([0.0, 0.0, 100.0]), v_WB_B=np.zeros(3), R_WB=tilted)
    x = flown(
        x,
        Input(throttle=0.0, w_WB_B=np.zeros(3)),
        body,
        dynamics=dynamics,
        duration=2.0,
        steps=4,
    )
    assert_allclose(x.v_WB_W, [0.0, 0.0, -2.0 * 9.81], atol=1e-12)
    assert_allclose(x.p_WB, [0.0, 0.0, 100.0 - 0.5 * 9.81 * 4.0], atol=1e-12)


@BOTH
def test_falling_ends_at_the_terminal_velocity(dynamics: str, gliding: Vehicle) -> None:
    idle = Input(throttle=0.0, w_WB_B=np.zeros(3))
    x = flown(at_rest(), idle, gliding, dynamics=dynamics, duration=150.0, steps=3000)
    assert_allclose(x.v_WB_W, [0.0, 0.0, -9.81 / 0.2], rtol=1e-9)


def test_a_spinning_body_flies_a_parabola(gliding: Vehicle) -> None:
    body = dataclasses.replace(gliding, drag=0.0)
    x = State(p_WB=np.zeros(3), v_WB_B=np.array([3.0, -1.0, 2.0]), R_WB=np.eye(3))
    spin = Input(throttle=0.0, w_WB_B=np.array([4.0, -3.0, 2.0]))
    duration = 1.0
    gravity = np.array([0.0, 0.0, -9.81])
    v_expected = x.v_WB_W + duration * gravity
    p_expected = duration * x.v_WB_W + 0.5 * duration**2 * gravity

    true = flown(x, spin, body, dynamics="rigid_body", duration=duration, steps=400)
    assert_allclose(true.v_WB_W, v_expected, atol=1e-8)
    assert_allclose(true.p_WB, p_expected, atol=1e-8)

    # Eq. (3) carries the velocity round with the body.
    printed = flown(x, spin, body, dynamics="paper", duration=duration, steps=400)
    assert np.linalg.norm(printed.v_WB_W - v_expected) > 1.0


def test_rigid_body_differs_from_the_paper_by_the_transport_term(vehicle: Vehicle) -> None:
    x = State(p_WB=np.zeros(3), v_WB_B=np.array([1.0, 0.0, 0.0]), R_WB=np.eye(3))
    u = hovering(vehicle, (0.0, 0.0, 2.0))
    difference = rate(x, u, vehicle) - rate(x, u, vehicle, dynamics="paper")
    # Turning left, what was forward velocity becomes velocity to the right of the nose.
    assert_allclose(difference, [0, 0, 0, 0, -2.0, 0, 0, 0, 0], atol=1e-15)


def quaternion_rate(q: Array, w_B: Array) -> Array:
    """Return dq/dt = 1/2 q w of a scalar-first quaternion."""
    w, x, y, z = q
    a, b, c = w_B
    return 0.5 * np.array(
        [
            -x * a - y * b - z * c,
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
        ]
    )


def turned(q: Array, vector: Array) -> Array:
    """Return the vector turned by a scalar-first quaternion."""
    return vector + 2.0 * np.cross(q[1:], np.cross(q[1:], vector) + q[0] * vector)


def exact(
    x: State, u: Input, vehicle: Vehicle, *, transported: bool, duration: float
) -> tuple[Array, Array, Array]:
    """Return position, world velocity and rotation, integrated to 1e-12.

    The rigid body is integrated in world coordinates; Eq. (3) with its velocity in the body.
    """
    a, b, c = vehicle.thrust_curve
    lift = 4.0 * (a * u.throttle**2 + b * u.throttle + c) / vehicle.mass
    down = np.array([0.0, 0.0, -vehicle.gravity])
    up_B = np.array([0.0, 0.0, lift])

    def world(_: float, y: Array) -> Array:
        v_W, q = y[3:6], y[6:]
        a_W = down + turned(q, up_B) - vehicle.drag * v_W
        return np.concatenate((v_W, a_W, quaternion_rate(q, u.w_WB_B)))

    def body(_: float, y: Array) -> Array:
        v_B, q = y[3:6], y[6:]
        back = q * [1.0, -1.0, -1.0, -1.0]
        a_B = turned(back, down) + up_B - vehicle.drag * v_B
        return np.concatenate((turned(q, v_B), a_B, quaternion_rate(q, u.w_WB_B)))

    q0 = np.roll(Rotation.from_matrix(x.R_WB).as_quat(), 1)
    start = np.concatenate((x.p_WB, x.v_WB_W if transported else x.v_WB_B, q0))
    end = solve_ivp(
        world if transported else body,
        (0.0, duration),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    ).y[:, -1]
    q = end[6:] / np.linalg.norm(end[6:])
    return (
        end[:3],
        end[3:6] if transported else turned(q, end[3:6]),
        Rotation.from_quat(np.roll(q, -1)).as_matrix(),
    )


TUMBLING = State(
    p_WB=np.array([1.0, -2.0, 3.0]),
    v_WB_B=np.array([4.0, -1.0, 2.0]),
    R_WB=Rotation.from_euler("xyz", [0.5, -0.8, 2.0]).as_matrix(),
)
TUMBLE = Input(throttle=0.6, w_WB_B=np.array([6.0, -4.0, 3.0]))


@BOTH
def test_integration_agrees_with_an_independent_one(dynamics: str, vehicle: Vehicle) -> None:
    p, v_W, R = exact(
        TUMBLING, TUMBLE, vehicle, transported=dynamics == "rigid_body", duration=0.5
    )
    x = flown(TUMBLING, TUMBLE, vehicle, dynamics=dynamics, duration=0.5, steps=1000)
    assert_allclose(x.p_WB, p, rtol=0.0, atol=1e-10)
    assert_allclose(x.v_WB_W, v_W, rtol=0.0, atol=1e-10)
    assert_allclose(x.R_WB, R, rtol=0.0, atol=1e-11)


@BOTH
def test_integration_is_of_fourth_order(dynamics: str, vehicle: Vehicle) -> None:
    p, v_W, R = exact(
        TUMBLING, TUMBLE, vehicle, transported=dynamics == "rigid_body", duration=0.5
    )
    errors = []
    for steps in (8, 16, 32):
        x = flown(TUMBLING, TUMBLE, vehicle, dynamics=dynamics, duration=0.5, steps=steps)
        errors.append(np.linalg.norm(np.concatenate((x.p_WB - p, x.v_WB_W - v_W))))
        # The body rate is constant, so the attitude has no error at any step.
        assert_allclose(x.R_WB, R, rtol=0.0, atol=1e-11)
    orders = [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]
    assert all(3.7 < order < 4.5 for order in orders), orders


@BOTH
def test_the_rate_is_where_the_integrator_goes(dynamics: str, vehicle: Vehicle) -> None:
    duration = 1e-6
    x = integrate(TUMBLING, TUMBLE, vehicle, dynamics=dynamics, duration=duration)
    assert_allclose(
        boxminus(x, TUMBLING) / duration,
        rate(TUMBLING, TUMBLE, vehicle, dynamics=dynamics),
        atol=1e-4,
    )
