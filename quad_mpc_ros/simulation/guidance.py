"""What guides a simulated flight around obstacles and through gates, which is optional."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from quad_mpc_ros.configuration import optional_part
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.guide import Guide
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages.obstacle_messages import Marker
from quad_mpc_ros.messages.point_cloud import PointCloud


class World(Protocol):
    """The obstacles that a guide has received in flight.

    Each raises ``ValueError`` for what is of no use.
    """

    def receive_odometry(self, odometry: OdometrySample) -> None:
        """Take where the vehicle is."""

    def receive_cloud(self, cloud: PointCloud) -> None:
        """Take what a sensor saw as points."""

    def receive_markers(self, markers: Sequence[Marker]) -> None:
        """Take shapes."""


class Guidance(Protocol):
    """The obstacles and the guide around them; each is None where nothing is configured."""

    @property
    def world(self) -> World | None:
        """What the guide knows of obstacles."""

    @property
    def guide(self) -> Guide | None:
        """What leads the controller."""


def configured_guidance(config: MpcConfig) -> Guidance | None:
    """Return what guides a controller, None where nothing is configured to.

    Raises :class:`UserError` for a file that cannot be used.
    """
    if not config.guided_by:
        return None
    guidance: Guidance = optional_part("guidance", needed_by=config.guided_by)(config)
    return guidance
