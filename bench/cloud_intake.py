# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measure the cost of clouds of 100,000 points, as a share of a core at 10 Hz.

    python -P bench/cloud_intake.py [--points 100000] [--scans 60]

A lidar of that many rays in a hall of 20 m by 14 m by 5 m with forty pillars, from a vehicle that
flies through at 2 m/s: bytes in, points of the world out. The time is that of the processor in the
thread that does it, so other processes do not count.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.obstacles.simulated import ray_lengths
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld
from quad_mpc_ros.messages.point_cloud import (
    PointCloud,
    point_cloud_from_message,
    written_point_cloud,
)
from quad_mpc_ros.messages.topics import OBSTACLES
from quad_mpc_ros.ros.messages import message_in
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape

RATE, SPEED = 10.0, 2.0  # Hz, m/s
HALL = np.array([20.0, 14.0, 5.0])


def surroundings(random: np.random.Generator) -> list[Shape]:
    """Return walls, floor and ceiling of the hall, and pillars in it."""
    shapes: list[Shape] = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            place, size = np.array([0.0, 0.0, 0.5 * HALL[2]]), HALL.copy()
            place[axis] += side * HALL[axis]
            size[axis] = 0.1
            shapes.append(Box(p_WO=place, size=size))
    for x, y in random.uniform([-9, -6], [9, 6], (40, 2)):
        shapes.append(Cylinder(p_WO=np.array([x, y, 2.5]), radius=0.15, height=5.0))
    return shapes


def seen(shapes: list[Shape], eye: Array, count: int, random: np.random.Generator) -> Array:
    """Return the ends (n, 3) [m] of rays in all directions, with a noise of 1 cm along them."""
    rays = random.normal(size=(count, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    lengths = np.min([ray_lengths(shape, eye, rays) for shape in shapes], axis=0)
    return np.asarray(rays * (lengths + 0.01 * random.normal(size=count))[:, None])


def measure(clouds: str, *, points: int, scans: int) -> tuple[float, float, int]:
    """Return the time of the processor for a cloud [s] and for the points [s], and how many."""
    random = np.random.default_rng(0)
    world = ObstacleWorld(ObstacleParameters(half_spaces=8, clouds=clouds))
    shapes, intake, asking = surroundings(random), 0.0, 0.0
    for number in range(scans):
        stamp_ns = round(1e9 * (1.0 + number / RATE))
        eye = np.array([-8.0 + SPEED * number / RATE, 0.0, 1.5])
        p_SQ = seen(shapes, eye, points, random)
        data = written_point_cloud(PointCloud(stamp_ns=stamp_ns, frame_id="base_link", p_SQ=p_SQ))
        world.receive_odometry(OdometrySample.at_rest(eye, stamp_ns=stamp_ns))
        began = time.thread_time()
        world.receive_cloud(point_cloud_from_message(message_in(OBSTACLES, data)))
        taken = time.thread_time()
        found = world.points(stamp_ns, near=eye, radius=8.0)
        intake, asking = intake + taken - began, asking + time.thread_time() - taken
    return intake / scans, asking / scans, len(found)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--scans", type=int, default=60)
    options = parser.parse_args()
    print("clouds  taken in [ms]  share of a core  points asked for [ms]  known within 8 m")
    for clouds in ("scan", "map"):
        intake, asking, known = measure(clouds, points=options.points, scans=options.scans)
        print(
            f"{clouds:6}  {1e3 * intake:13.2f}  {RATE * intake:15.1%}  {1e3 * asking:21.2f}  "
            f"{known:16}"
        )


if __name__ == "__main__":
    main()
