"""A centre of mass that is off: what rates have beyond their commands is learned."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros import load_config
from quad_mpc_ros.simulation.closed_loop import fly, start_on
from quad_mpc_ros.trajectories.configured import configured_trajectory


def settled_error(*, learned: bool) -> float:
    """Return the mean error [m] of a circle at 8 m/s once it has settled.

    The integral of the rate loop is too weak to hold the torque.
    """
    mpc, simulator, reference = load_config(
        "vehicles/sun_2022",
        assignments=(
            f"mpc.estimate_disturbance={str(learned).lower()}",
            "mpc.lockstep=true",
            "mpc.control_rate=100.0",
            "simulator.odom_rate=100.0",
            "simulator.duration=6.0",
            "simulator.airframe.center_of_mass=[0.014, 0.0, 0.0]",
            "simulator.rate_loop.integral_max=[20.0, 20.0, 20.0]",
            "reference.trajectory=ellipse",
            "reference.ellipse_semi_axes=[4.0, 4.0]",
            "reference.ellipse_frequency=2.0",
            "reference.ellipse_heading=centre",
            "reference.height=20.0",
        ),
    )
    trajectory = configured_trajectory(reference)
    steps = fly(
        mpc=mpc,
        simulator=simulator.updated(start_on(trajectory, simulator)),
        reference=reference,
        trajectory=trajectory,
    )
    errors = [np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]) for step in steps]
    return float(np.mean(errors[len(errors) // 2 :]))


def test_a_centre_of_mass_that_is_off_is_learned() -> None:
    learned = settled_error(learned=True)
    assert learned < 0.02
    assert learned < 0.3 * settled_error(learned=False)
