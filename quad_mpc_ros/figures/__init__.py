"""Pictures of flights and references. Matplotlib is imported only when something is drawn."""

from quad_mpc_ros.figures.comparison import write_comparison
from quad_mpc_ros.figures.flight_figures import FIGURE_NAMES, write_figures

__all__ = ["FIGURE_NAMES", "write_comparison", "write_figures"]
