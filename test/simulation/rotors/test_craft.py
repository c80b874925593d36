"""That every number arrives under its own name in compiled code."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.rotors import VEHICLES, Equations, configured
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.simulation.rotors.craft import Craft, inertia_tensor, rotors_of
from quad_mpc_ros.simulation.rotors.parameters import (
    AirframeParameters,
    BatteryParameters,
    RateLoopParameters,
    RotorParameters,
)


@pytest.mark.parametrize("name", VEHICLES)
def test_craft_has_the_configured_numbers(name: str) -> None:
    config = configured(name, battery__capacity=1.3, mass_scale=1.1, thrust_scale=0.9)
    craft = Equations.of(config).craft[()]
    tensor = inertia_tensor(config.airframe.inertia)
    assert craft.mass == pytest.approx(1.1 * config.mass)
    assert craft.thrust_coefficient == pytest.approx(0.9 * config.rotors.thrust_coefficient)
    assert craft.rotor_inertia == config.rotors.inertia
    assert craft.rotor_drag == config.rotors.drag
    assert craft.translational_lift == pytest.approx(config.airframe.translational_lift / 4.0)
    assert craft.capacity == pytest.approx(1.3 * 3600.0)
    assert_array_equal(craft.center_B, config.airframe.center_of_mass)
    assert_array_equal(craft.inertia, tensor)
    assert craft.longest_step_ns == 5_000_000
    assert_allclose(craft.inverse_inertia @ tensor, np.eye(3), atol=1e-9)
    alike = (config, config.rotors, config.airframe, config.battery)
    own = {"mass", "thrust_coefficient", "rotor_inertia", "rotor_drag", "translational_lift"}
    own |= {"capacity", "center_B", "inertia", "inverse_inertia", "longest_step_ns", "radius"}
    assert craft.radius == config.rotors.radius  # of the propellers, not of the vehicle
    for field in set(Craft.dtype.names or ()) - own:
        (value,) = [getattr(group, field) for group in alike if hasattr(group, field)]
        assert_array_equal(getattr(craft, field), value, err_msg=field)


def test_tilt_turns_the_thrust_axis() -> None:
    """About x by a positive angle body z turns to the right, about y forwards."""
    rotors = rotors_of(
        RotorParameters(tilt_x=(0.1, 0.0, 0.2, 0.0), tilt_y=(0.0, 0.3, -0.1, 0.0)),
        center_B=np.zeros(3),
    )
    axes = rotors["axis"]
    assert_allclose(axes[0], [0.0, -np.sin(0.1), np.cos(0.1)])
    assert_allclose(axes[1], [np.sin(0.3), 0.0, np.cos(0.3)])
    assert_allclose(axes[2], so3.exp(np.array([0.2, -0.1, 0.0]))[:, 2])
    assert_allclose(axes[3], [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RotorParameters(y=(0.1, 0.1)), r"rotors\.y: given .*4 numbers, as x has"),
        (lambda: RotorParameters(spin=(1.0, 0.5, 1.0, 1.0)), r"rotors\.spin"),
        (lambda: RotorParameters(speed_min=3000.0), r"rotors\.speed_min: .*below 1966"),
        (
            lambda: AirframeParameters(inertia=(1.0, 1.0, 1.0, 2.0, 0.0, 0.0)),
            r"airframe\.inertia: .*positive definite",
        ),
        (lambda: RateLoopParameters(rate=100.0), r"rate_loop\.d_cutoff: .*half of 100 Hz"),
        (
            lambda: BatteryParameters(voltage_empty=20.0),
            r"battery\.voltage_empty: .*most 16\.8",
        ),
    ],
)
def test_refuses_impossible_vehicles(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(ConfigurationError, match=rf"^simulator\.{message}"):
        make()
