"""A world and the guide around what is in it, as the parameters of the MPC have them."""

from __future__ import annotations

from typing import NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.obstacles.avoidance import ObstacleAvoidance
from quad_mpc_ros.obstacles.files import scene_of_file
from quad_mpc_ros.obstacles.world import World


class Avoiding(NamedTuple):
    """What is told of obstacles, and what leads around them."""

    world: World
    guide: ObstacleAvoidance

    def reset_estimate(self) -> None:
        """Forget what was seen and made of it: the frame of the odometry has moved."""
        self.world.reset_estimate()
        self.guide.surroundings.forget()


def avoiding(config: MpcConfig) -> Avoiding | None:
    """Return world and guide; None where ``obstacles.half_spaces`` is 0, to know of no obstacles.

    Raises :class:`UserError` for a file that cannot be used.
    """
    own = config.obstacles
    if own.half_spaces == 0:
        return None
    frame_id = config.odometry.frame_id
    world = World(own, scene_of_file(own.file), frame_id=frame_id, radius=config.radius)
    neighbours = world if own.neighbours else None
    guide = ObstacleAvoidance(config, world, radius=config.radius, neighbours=neighbours)
    return Avoiding(world, guide)
