# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Shapes against points on their surface, marching along rays, and an independent library."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.obstacles.files import rotation_about_z
from quad_mpc_ros.extras.obstacles.simulated import ray_lengths
from quad_mpc_ros.extras.obstacles.surfaces import area, surface_points
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere

SPACING = 0.02
PLACE = np.array([1.0, -2.0, 3.0])
TILTED = so3.exp(np.array([0.3, -0.5, 0.9]))

SHAPES: dict[str, Shape] = {
    "box": Box(p_WO=PLACE, R_WO=rotation_about_z(0.4), size=np.array([0.4, 1.0, 2.0])),
    "tilted box": Box(p_WO=PLACE, R_WO=TILTED, size=np.array([0.7, 0.2, 1.1])),
    "cylinder": Cylinder(p_WO=PLACE, radius=0.3, height=1.2),
    "disc": Cylinder(p_WO=PLACE, R_WO=TILTED, radius=0.6, height=0.1),
    "sphere": Sphere(p_WO=PLACE, radius=0.7),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())


def places_around(shape: Shape, count: int = 400) -> Array:
    random = np.random.default_rng(0)
    return shape.p_WO + random.normal(scale=0.8, size=(count, 3))


@every_shape
def test_surface_points_have_zero_distance(shape: Shape) -> None:
    points = surface_points(shape, SPACING)
    assert np.abs(shape.distance(points)).max() < 1e-12


@every_shape
def test_distance_equals_the_nearest_surface_point(shape: Shape) -> None:
    places = places_around(shape)
    nearest, _ = cKDTree(surface_points(shape, SPACING)).query(places)
    error = nearest - np.abs(shape.distance(places))
    assert error.min() > -1e-9  # no point of it is nearer
    assert error.max() < SPACING / math.sqrt(2.0)


@every_shape
@pytest.mark.parametrize("spacing", [0.05, 0.3, 5.0])
def test_points_of_the_surface_leave_no_gap(shape: Shape, spacing: float) -> None:
    fine, coarse = surface_points(shape, SPACING), surface_points(shape, spacing)
    gaps, _ = cKDTree(coarse).query(fine)
    assert gaps.max() <= min(spacing, 2.0 * shape.outer_radius) / math.sqrt(2.0) + SPACING


@every_shape
def test_area_predicts_the_number_of_points(shape: Shape) -> None:
    count = len(surface_points(shape, SPACING))
    assert count == pytest.approx(area(shape) / SPACING**2, rel=0.15)


@every_shape
def test_inside_is_negative_and_the_centre_is_inside(shape: Shape) -> None:
    inside = float(shape.distance(shape.p_WO[None])[0])
    assert inside == pytest.approx(-float(shape.half_extents.min()))
    assert (shape.distance(shape.p_WO + 10.0 * np.eye(3)) > 0.0).all()


@every_shape
def test_outer_radius_is_the_smallest_enclosing_sphere(shape: Shape) -> None:
    away = np.linalg.norm(surface_points(shape, SPACING) - shape.p_WO, axis=1)
    assert away.max() == pytest.approx(shape.outer_radius, rel=1e-3)
    assert away.max() <= shape.outer_radius + 1e-12


@every_shape
def test_ray_lengths_agree_with_ray_marching(shape: Shape) -> None:
    random = np.random.default_rng(2)
    rays = random.normal(size=(300, 3))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    eye = shape.p_WO + np.array([1.5, 0.4, 0.3])
    lengths = ray_lengths(shape, eye, rays)
    meets = np.isfinite(lengths)
    assert 0 < meets.sum() < len(rays)
    ends = eye + lengths[meets, None] * rays[meets]
    assert np.abs(shape.distance(ends)).max() < 1e-9
    steps = np.linspace(0.0, 4.0, 4001)[:, None]
    for ray, length in zip(rays, lengths, strict=True):
        inside = shape.distance(eye + steps * ray) <= 0.0
        marched = float(steps[np.argmax(inside), 0]) if inside.any() else math.inf
        if math.isfinite(marched) or math.isfinite(length):
            # One that only grazes it is met between two steps.
            grazes = shape.distance(eye + steps * ray).min() < 1e-3
            assert marched == pytest.approx(length, abs=2e-3) or grazes


@every_shape
def test_a_ray_from_inside_ends_at_once(shape: Shape) -> None:
    assert ray_lengths(shape, shape.p_WO, np.eye(3)).tolist() == [0.0, 0.0, 0.0]


def test_yaw_turns_from_east_to_north() -> None:
    box = Box(p_WO=np.zeros(3), R_WO=rotation_about_z(math.pi / 2), size=np.array([2.0, 0.2, 0.2]))
    assert (
        box.distance(np.array([[0.0, 0.9, 0.0]]))[0]
        < 0.0
        < box.distance(np.array([[0.9, 0.0, 0.0]]))[0]
    )


def test_a_shape_moves_only_after_it_appears() -> None:
    sphere = Sphere(p_WO=np.zeros(3), radius=0.1, v_WO_W=np.array([2.0, 0.0, 0.0]), appears_at=1.0)
    assert sphere.after(0.5).p_WO[0] == 0.0
    assert sphere.after(1.5).p_WO[0] == pytest.approx(1.0)
