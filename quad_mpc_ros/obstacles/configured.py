"""What leads around obstacles and through gates, as the parameters of the MPC have it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Guide
from quad_mpc_ros.obstacles.files import scene_of_file
from quad_mpc_ros.obstacles.held_gates import GuidedThrough, HeldGates
from quad_mpc_ros.references.gates import read_course

if TYPE_CHECKING:
    from quad_mpc_ros.obstacles.surroundings import Surroundings
    from quad_mpc_ros.obstacles.world import World


class Guidance(NamedTuple):
    """What is told of obstacles and of gates, and what leads around them and through them.

    Each is None where there is nothing of the kind; ``surroundings`` is what is made of the world.
    """

    world: World | None = None
    surroundings: Surroundings | None = None
    gates: HeldGates | None = None
    guide: Guide | None = None

    def reset_estimate(self) -> None:
        """Forget what was seen and made of it: the frame of the odometry has moved."""
        if self.world is not None and self.surroundings is not None:
            self.world.reset_estimate()
            self.surroundings.forget()


def guidance(config: MpcConfig) -> Guidance:
    """Return what guides a controller.

    Obstacles do with ``obstacles.half_spaces`` above 0, gates with ``formulation`` contouring.
    Raises :class:`UserError` for a file that cannot be used.
    """
    gates = None
    if config.holds_gates:
        gates = HeldGates(read_course(config.gates), radius=config.radius)
    own = config.obstacles
    if own.half_spaces == 0:
        return Guidance(gates=gates, guide=gates)
    # SciPy's KD-trees take 16 MiB and a tenth of a second.
    from quad_mpc_ros.obstacles.avoidance import ObstacleAvoidance
    from quad_mpc_ros.obstacles.world import World

    frame_id = config.odometry.frame_id
    world = World(own, scene_of_file(own.file), frame_id=frame_id, radius=config.radius)
    neighbours = world if own.neighbours else None
    around = ObstacleAvoidance(config, world, radius=config.radius, neighbours=neighbours)
    guide: Guide = around if gates is None else GuidedThrough(around, gates)
    return Guidance(world, around.surroundings, gates, guide)
