# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Conservation of angular momentum, balance of energy, order of the integrator."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from fixtures.rotors import NO_AIR, Equations, Flying, configured
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import Array

TENSOR = (8.2e-4, 6.9e-4, 1.41e-3, 1.0e-4, -0.5e-4, 0.8e-4)
CROOKED: dict[str, Any] = {
    "airframe.inertia": TENSOR,
    "airframe.center_of_mass": (0.01, -0.02, 0.005),
    "rotors.inertia": 2.0e-5,
    "rotors.z": (0.02, -0.01, 0.03, 0.0),
}
# The smallest thrust that the parameters permit.
NO_THRUST = {"rotors.thrust_coefficient": 1e-30, "rotors.torque_coefficient": 1e-30}


def equations(**changes: Any) -> Equations:
    return Equations.of(configured().updated({**NO_AIR, **CROOKED, **changes}))


@pytest.mark.parametrize("seed", range(3))
def test_angular_momentum_of_body_and_rotors_is_conserved(seed: int) -> None:
    """The rotors exchange angular momentum with a tumbling body."""
    body = equations(**NO_THRUST)
    x, wanted = body.random(seed)
    later = body.after(x, wanted, duration=0.5, steps=2000)
    assert np.abs(later.speeds - x.speeds).max() > 100.0
    assert np.abs(later.body["w_WB_B"] - x.body["w_WB_B"]).max() > 1.0
    before = body.angular_momentum(x)
    assert_allclose(
        body.angular_momentum(later), before, rtol=0.0, atol=1e-8 * np.linalg.norm(before)
    )


@pytest.mark.parametrize("seed", range(5))
def test_energy_changes_by_the_work_of_motors_and_air(seed: int) -> None:
    """Each motor turns its rotor against its drag and its inertia, the body's turning included."""
    drag = (0.1, 0.2, 0.3)
    body = equations(**{"airframe.drag_linear": drag})
    x, wanted = body.random(seed)
    step = 1e-5
    ahead, back = (body.after(x, wanted, duration=sign * step) for sign in (1.0, -1.0))
    found = (body.energy(ahead) - body.energy(back)) / (2.0 * step)
    assert found == pytest.approx(work(body, x, body.rate(x, wanted), np.array(drag)), rel=1e-6)


def work(body: Equations, x: Flying, rate: Flying, drag: Array) -> float:
    """Return the power of motors and air on a vehicle that moves as its state and rate say [W]."""
    w, rotors = x.body["w_WB_B"], body.config.rotors
    v_B = x.R_WB.T @ x.body["v_WC_W"]
    total = -float(drag @ (v_B * v_B))
    for rotor, speed, faster in zip(body.rotors, x.speeds, rate.speeds, strict=True):
        place, axis, spin = rotor.place, np.array([0.0, 0.0, 1.0]), rotor.spin
        resisted = rotors.torque_coefficient * speed**2
        turned = speed + spin * w @ axis  # of the rotor in the world, about its axis
        motor = resisted + rotors.inertia * (faster + spin * rate.body["w_WB_B"] @ axis)
        thrust = rotors.thrust_coefficient * speed**2 * axis
        total += motor * speed - resisted * turned + thrust @ (v_B + np.cross(w, place))
    return float(total)


def test_the_integrator_is_of_fourth_order() -> None:
    """Half the step, a sixteenth of the error."""
    body = Equations.of(configured("sun_2022").updated({"rotors.inertia": 1e-5}))
    x, wanted = body.random(4)
    exact = body.after(x, wanted, duration=0.2, steps=2560).motion
    errors = [
        np.abs(body.after(x, wanted, duration=0.2, steps=steps).motion - exact).max()
        for steps in (20, 40, 80)
    ]
    for coarse, fine in itertools.pairwise(errors):
        assert coarse / fine == pytest.approx(16.0, rel=0.15)
