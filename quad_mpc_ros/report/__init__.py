"""Runs, or campaigns, on one page: a self-contained HTML file; and the series of runs as CSV.

:func:`read_runs` reads bags, :func:`page` makes the HTML, :func:`csv_tables` the tables;
:func:`read_campaigns` and :func:`campaign_page` do so for campaigns. Nothing here imports rclpy;
Plotly, an extra of the package, is imported when a page is made.
"""

from quad_mpc_ros.report.campaign import ReportedCampaign, is_campaign, read_campaigns
from quad_mpc_ros.report.campaign_page import campaign_page, write_campaign_page
from quad_mpc_ros.report.page import page
from quad_mpc_ros.report.plotting import PLOTLY_NEEDED
from quad_mpc_ros.report.run import ReportedRun, read_runs
from quad_mpc_ros.report.series import TABLE_NAMES, csv_tables

__all__ = [
    "PLOTLY_NEEDED",
    "TABLE_NAMES",
    "ReportedCampaign",
    "ReportedRun",
    "campaign_page",
    "csv_tables",
    "is_campaign",
    "page",
    "read_campaigns",
    "read_runs",
    "write_campaign_page",
]
