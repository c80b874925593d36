"""The odometry of a recorded run as a reference to fly again."""

from __future__ import annotations

from pathlib import Path

from quad_mpc_ros.evaluation.flight import read_flight
from quad_mpc_ros.trajectories.point_table import PointTable


def read_recording(bag: Path) -> PointTable:
    """Return where the vehicle of a bag was, by the stamps of its odometry.

    Raises :class:`UserError` for a bag that cannot be read and for too few odometries.
    """
    flight = read_flight(bag)
    return PointTable(source=str(bag), seconds=flight.time, p_WB=flight.p_WB)
