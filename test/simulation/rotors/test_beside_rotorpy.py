"""The Hummingbird with rotorpy's numbers beside rotorpy's own: two authors, one vehicle."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.rotors import command, plant
from numpy.testing import assert_allclose

from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.simulation.config import make_plant

PERIOD_NS = 20_000_000


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (4.0, -3.0, 1.0)])
def test_manoeuvre_agrees_with_rotorpy(
    wind: tuple[float, float, float],
) -> None:
    """Rolls, pitches and turns at once, up to 10 m/s; the largest distance is below 1 cm."""
    pytest.importorskip("rotorpy.vehicles.multirotor")
    config = load_config("rotorpy").simulator
    hover = config.vehicle().hover_throttle
    start = {"initial_position": (0.0, 0.0, 50.0), "initial_throttle": hover, "wind": wind}
    theirs = make_plant(config.updated(start))
    mine = plant("hummingbird", wind=wind)
    furthest, fastest = 0.0, 0.0
    for tick in range(250):
        t = tick * 0.02
        rates = (2.0 * np.sin(3.0 * t), 2.5 * np.cos(2.0 * t), 0.8 * np.sin(t))
        for body in (mine, theirs):
            body.apply(command(hover * (1.0 + 0.2 * np.sin(4.0 * t)), rates))
            body.advance_to((tick + 1) * PERIOD_NS)
        seen, truth = mine.odometry(0), theirs.odometry(0)
        furthest = max(furthest, float(np.linalg.norm(seen.p_WB - truth.p_WB)))
        fastest = max(fastest, float(np.linalg.norm(truth.v_WB_B)))
        assert_allclose(seen.w_WB_B, truth.w_WB_B, atol=0.01)
    assert fastest > 5.0
    assert furthest < 0.01


def test_the_hummingbird_has_the_numbers_of_rotorpy() -> None:
    pytest.importorskip("rotorpy.vehicles.multirotor")
    from rotorpy.vehicles.hummingbird_params import quad_params

    config = load_config("vehicles/hummingbird").simulator
    rotors, airframe = config.rotors, config.airframe
    names = {
        "thrust_coefficient": "k_eta",
        "torque_coefficient": "k_m",
        "time_constant": "tau_m",
        "inflow_loss": "k_z",
        "drag": "k_d",
        "radius": "rotor_radius",
        "speed_min": "rotor_speed_min",
        "speed_max": "rotor_speed_max",
    }
    assert {name: getattr(rotors, name) for name in names} == {
        name: quad_params[theirs] for name, theirs in names.items()
    }
    assert config.mass == quad_params["mass"]
    assert airframe.inertia[:3] == tuple(quad_params[name] for name in ("Ixx", "Iyy", "Izz"))
    assert airframe.drag_quadratic == tuple(quad_params[f"c_D{axis}"] for axis in "xyz")
    assert airframe.translational_lift == pytest.approx(4.0 * quad_params["k_h"])
    theirs = zip(quad_params["rotor_pos"].values(), quad_params["rotor_directions"], strict=True)
    # Theirs is the direction of the torque on the body.
    assert_allclose(
        sorted(
            (x, y, z, spin)
            for x, y, z, spin in zip(rotors.x, rotors.y, rotors.z, rotors.spin, strict=True)
        ),
        sorted((*place, -sense) for place, sense in theirs),
        atol=1e-8,
    )
