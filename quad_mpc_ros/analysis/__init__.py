"""Recorded runs evaluated: a flight as arrays, its figures of merit, its pictures.

:func:`read_flight` reads a bag, :func:`summarise` measures it, :func:`summary_table` shows that
in a terminal, :func:`write_figures` and :func:`write_comparison` draw. Nothing here imports rclpy
or a message package, and matplotlib only when something is drawn.
"""

from quad_mpc_ros.analysis.comparison import write_comparison
from quad_mpc_ros.analysis.figures import write_figures
from quad_mpc_ros.analysis.flight import CommandTrack, Flight, ReferenceTrack, read_flight
from quad_mpc_ros.analysis.metrics import summarise
from quad_mpc_ros.analysis.table import summary_table

__all__ = [
    "CommandTrack",
    "Flight",
    "ReferenceTrack",
    "read_flight",
    "summarise",
    "summary_table",
    "write_comparison",
    "write_figures",
]
