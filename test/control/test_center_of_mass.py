# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A centre of mass that is off: what rates have beyond their commands is learned and taken off."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros import load_config
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.closed_loop import fly, start_on


def flown(*, learned: bool, ahead: float) -> tuple[float, list[float]]:
    """Return the mean error [m] of an upright ellipse after convergence, and pitch's offsets."""
    mpc, simulator, reference = load_config(
        "vehicles/sun_2022",
        assignments=(
            f"mpc.estimate_disturbance={str(learned).lower()}",
            "mpc.lockstep=true",
            "mpc.control_rate=100.0",
            "mpc.limits.tilt_max=0.0",
            "simulator.odom_rate=100.0",
            "simulator.duration=5.0",
            f"simulator.airframe.center_of_mass=[{ahead}, 0.0, 0.0]",
            "simulator.rate_loop.integral_max=[20.0, 20.0, 20.0]",
            "reference.trajectory=ellipse",
            "reference.ellipse_plane=horizontal",
            "reference.ellipse_semi_axes=[4.0, 2.0]",
            "reference.ellipse_frequency=2.0",
            "reference.ellipse_heading=centre",
            "reference.height=20.0",
        ),
    )
    trajectory = configured_trajectory(reference)
    errors, offsets = [], []
    for step in fly(
        mpc=mpc,
        simulator=simulator.updated(start_on(trajectory, simulator)),
        reference=reference,
        trajectory=trajectory,
    ):
        errors.append(float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0])))
        if step.tick is not None:
            offsets.append(step.tick.stats.rate_offset_y)
    return float(np.mean(errors[len(errors) // 2 :])), offsets


@pytest.mark.parametrize("ahead", [0.014, -0.014])
def test_estimates_offset_centre_of_mass(ahead: float) -> None:
    error, offsets = flown(learned=True, ahead=ahead)
    without, none = flown(learned=False, ahead=ahead)
    assert error < 0.02
    assert error < 0.3 * without
    assert np.mean(offsets[250:]) * ahead > 0.0
    assert not np.any(none)


def test_centred_mass_gives_almost_no_offset() -> None:
    _, offsets = flown(learned=True, ahead=0.0)
    assert np.abs(offsets[250:]).max() < 0.1
