"""Runs on one page: a self-contained HTML file, and the time series behind it as CSV.

:func:`read_runs` reads bags, :func:`page` makes the HTML, :func:`csv_tables` the tables. Nothing
here imports rclpy; Plotly, an extra of the package, is imported when a page is made.
"""

from quad_mpc_ros.report.page import page
from quad_mpc_ros.report.run import ReportedRun, read_runs
from quad_mpc_ros.report.series import TABLE_NAMES, csv_tables

__all__ = ["TABLE_NAMES", "ReportedRun", "csv_tables", "page", "read_runs"]
