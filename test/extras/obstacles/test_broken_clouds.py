# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A flight whose clouds stop, jump, lie, come late and are full of NaN: the MPC flies through."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros import load_config
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.guidance import guidance
from quad_mpc_ros.extras.obstacles.surfaces import surface_points
from quad_mpc_ros.messages.point_cloud import (
    PointCloud,
    point_cloud_from_message,
    written_point_cloud,
)
from quad_mpc_ros.messages.topics import OBSTACLES
from quad_mpc_ros.ros.messages import message_in
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.shapes import Cylinder

PILLAR = Cylinder(p_WO=np.array([2.0, 0.0, 1.5]), radius=0.15, height=3.0)
SURFACE = surface_points(PILLAR, 0.1)
PERIOD = 5  # odometries between two clouds


class Liar:
    """Makes clouds of the pillar's surface, each second broken in another way."""

    PHASES = ("sound", "stopped", "nan", "jumping", "late", "elsewhere", "inside", "sound")

    def __init__(self) -> None:
        self._random = np.random.default_rng(7)

    def phase(self, step: LoopStep) -> str:
        return self.PHASES[int((step.odometry.stamp_ns - 1_000_000_000) * 1e-9)]

    def cloud(self, step: LoopStep) -> PointCloud | None:
        """Return a cloud in the frame of the odometry, None for none."""
        stamp_ns, frame_id, points = step.odometry.stamp_ns, "odom", SURFACE
        match self.phase(step):
            case "stopped":
                return None
            case "nan":
                points = np.full_like(SURFACE, np.nan)
            case "jumping":
                points = SURFACE + self._random.normal(scale=3.0, size=3)
            case "late":
                stamp_ns -= 5_000_000_000
            case "elsewhere":
                frame_id = "moon"
            case "inside":
                points = self._around(step.odometry.p_WB)
        return PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=points)

    def _around(self, p_WB: Array) -> Array:
        """Return points on a ball that holds the vehicle."""
        rays = self._random.normal(size=(200, 3))
        return np.asarray(p_WB + 0.3 * rays / np.linalg.norm(rays, axis=1, keepdims=True))


def test_mpc_flies_on_with_malformed_clouds() -> None:
    settings = [
        "reference.trajectory=hover",
        "reference.height=1.5",
        "mpc.obstacles.half_spaces=8",
        "mpc.lockstep=true",
        f"simulator.duration={len(Liar.PHASES)}",
    ]
    config = load_config("default", assignments=settings)
    avoided = guidance(config.mpc)
    world, liar = avoided.world, Liar()
    assert world is not None
    refused = dict.fromkeys(Liar.PHASES, 0)
    away: dict[str, float] = {}
    for number, step in enumerate(
        fly(
            mpc=config.mpc,
            simulator=config.simulator,
            reference=config.reference,
            controller=warmed_up(config.mpc, guide=avoided.guide),
            world=world,
            on_reference=True,
        )
    ):
        assert step.tick is not None and step.command is not None
        assert step.tick.stats.source == "mpc", step.tick.stats.reason
        phase = liar.phase(step)
        away[phase] = max(
            away.get(phase, 0.0), float(np.linalg.norm(step.truth.p_WB - [0, 0, 1.5]))
        )
        cloud = liar.cloud(step) if number % PERIOD == 0 else None
        if cloud is None:
            continue
        try:
            received = message_in(OBSTACLES, written_point_cloud(cloud))
            world.receive_cloud(point_cloud_from_message(received))
        except ValueError:
            refused[phase] += 1
    clouds = 50 // PERIOD
    assert refused == dict.fromkeys(Liar.PHASES, 0) | dict.fromkeys(
        ("nan", "late", "elsewhere"), clouds
    )
    assert max(away[phase] for phase in ("stopped", "nan")) < 0.01  # the pillar is far enough
    assert max(away.values()) < 2.0
