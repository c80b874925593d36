# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The configured guide around obstacles and through gates."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Guide
from quad_mpc_ros.extras.obstacles.files import scene_of_file
from quad_mpc_ros.extras.racing.gates import read_course
from quad_mpc_ros.extras.racing.held_gates import CombinedGuide, HeldGates

if TYPE_CHECKING:
    from quad_mpc_ros.extras.obstacles.local_map import LocalMapProvider
    from quad_mpc_ros.extras.obstacles.world import ObstacleWorld


class Guidance(NamedTuple):
    """Obstacles, local map, gates and the guide; None if not configured."""

    world: ObstacleWorld | None = None
    surroundings: LocalMapProvider | None = None
    gates: HeldGates | None = None
    guide: Guide | None = None


def guidance(config: MpcConfig) -> Guidance:
    """Return the guidance of a controller.

    Obstacles are enabled with ``obstacles.half_spaces`` above 0, gates with ``formulation``
    contouring. Raises :class:`UserError` for an unusable file.
    """
    gates = None
    if config.holds_gates:
        gates = HeldGates(read_course(config.gates), radius=config.radius)
    own = config.obstacles
    if own.half_spaces == 0:
        return Guidance(gates=gates, guide=gates)
    # SciPy's KD-trees take 16 MiB and a tenth of a second.
    from quad_mpc_ros.extras.obstacles.avoidance import ObstacleAvoidance
    from quad_mpc_ros.extras.obstacles.world import ObstacleWorld

    frame_id = config.odometry.frame_id
    world = ObstacleWorld(own, scene_of_file(own.file), frame_id=frame_id)
    around = ObstacleAvoidance(config, world, radius=config.radius)
    guide: Guide = around if gates is None else CombinedGuide(around, gates)
    return Guidance(world, around.surroundings, gates, guide)
