"""Flights evaluated: arrays of what was flown, figures of merit, the summary on a terminal."""

from quad_mpc_ros.evaluation.flight import CommandTrack, Flight, ReferenceTrack, read_flight
from quad_mpc_ros.evaluation.metrics import summarise
from quad_mpc_ros.evaluation.table import summary_table

__all__ = [
    "CommandTrack",
    "Flight",
    "ReferenceTrack",
    "read_flight",
    "summarise",
    "summary_table",
]
