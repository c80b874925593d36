# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The ellipse: where it is, where the nose looks, and the published family made of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.ellipse import ellipse

AXES, W = (2.0, 0.8), 1.7


def config(**changes: object) -> ReferenceConfig:
    return ReferenceConfig.build(
        {
            "trajectory": "ellipse",
            "ellipse_semi_axes": AXES,
            "ellipse_frequency": W,
            "origin": [1.0, -2.0],
            "height": 3.0,
            **changes,
        }
    )


@pytest.mark.parametrize(("plane", "second"), [("horizontal", 1), ("vertical", 2)])
def test_path_is_the_ellipse_of_its_semi_axes(plane: str, second: int) -> None:
    seconds = np.linspace(0.0, 2.0 * np.pi / W, 100)
    path = ellipse(config(ellipse_plane=plane)).at(seconds)
    place = path.p_WB - [1.0, -2.0, 3.0]
    assert_allclose((place[:, 0] / AXES[0]) ** 2 + (place[:, second] / AXES[1]) ** 2, 1.0)
    assert_allclose(place[:, 3 - second], 0.0, atol=1e-12)
    assert_allclose(place[0, second], AXES[1])
    assert_allclose(path.v_WB_W[0], [AXES[0] * W, 0.0, 0.0], atol=1e-12)


def noses(heading: str, **changes: object) -> tuple[Array, Array, Array]:
    """Return places from the centre and velocities, and where x of the body points, all (n, 2)."""
    trajectory = configured_trajectory(config(ellipse_heading=heading, **changes))
    samples = trajectory.at([*range(0, trajectory.period_ns, trajectory.period_ns // 50)])
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    tilt = so3.shortest_rotation(np.tile([0.0, 0.0, 1.0], (len(R_WB), 1)), R_WB[:, :, 2])
    level = np.swapaxes(tilt, -1, -2) @ R_WB  # what is left of the attitude without its tilt
    return (samples.p_WB - [1.0, -2.0, 3.0])[:, :2], samples.v_WB_W[:, :2], level[:, :2, 0]


def unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


@pytest.mark.parametrize("axes", [AXES, (1.0, 1.0), (0.5, 2.0)])
def test_heading_points_to_the_centre_or_along_the_path(axes: tuple[float, float]) -> None:
    place, _, nose = noses("centre", ellipse_semi_axes=axes)
    assert_allclose(nose, -unit(place), atol=1e-9)
    _, velocity, nose = noses("along", ellipse_semi_axes=axes)
    assert_allclose(nose, unit(velocity), atol=1e-9)
    _, _, nose = noses("fixed", ellipse_semi_axes=axes, yaw=0.5)
    assert_allclose(nose, [[np.cos(0.5), np.sin(0.5)]] * len(nose), atol=1e-9)
    place, _, nose = noses("centre", ellipse_semi_axes=axes, yaw=np.pi)
    assert_allclose(nose, unit(place), atol=1e-9)


def test_rejects_heading_of_vertical_ellipse() -> None:
    with pytest.raises(ConfigurationError, match=r"reference\.ellipse_heading: given 'centre'"):
        config(ellipse_plane="vertical", ellipse_heading="centre")
