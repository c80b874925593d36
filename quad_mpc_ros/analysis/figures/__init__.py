"""Pictures of flights and references. Matplotlib is imported only when something is drawn."""

from quad_mpc_ros.analysis.figures.over_time import FIGURE_NAMES, write_figures

__all__ = ["FIGURE_NAMES", "write_figures"]
