"""The lags, the delay, the thrust and the drag of a vehicle, fitted to a recorded flight.

:func:`measurements_of` takes what is needed from a recording, :func:`fit` fits,
:func:`identification_table` and :func:`parameter_file` tell, :func:`write_fit_figure` shows.
:func:`learned` takes what the controller itself has estimated, :func:`learned_file` tells it.
"""

from quad_mpc_ros.identification.figure import write_fit_figure
from quad_mpc_ros.identification.fit import fit, identify
from quad_mpc_ros.identification.learned import Learned, learned, learned_file
from quad_mpc_ros.identification.measurements import Measurements, measurements_of
from quad_mpc_ros.identification.report import identification_table, parameter_file
from quad_mpc_ros.identification.result import Estimate, Identification

__all__ = [
    "Estimate",
    "Identification",
    "Learned",
    "Measurements",
    "fit",
    "identification_table",
    "identify",
    "learned",
    "learned_file",
    "measurements_of",
    "parameter_file",
    "write_fit_figure",
]
