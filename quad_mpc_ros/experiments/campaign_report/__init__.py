"""Campaigns on one page: a self-contained HTML file of :func:`campaign_page`."""

from quad_mpc_ros.experiments.campaign_report.campaign import (
    ReportedCampaign,
    is_campaign,
    read_campaigns,
)
from quad_mpc_ros.experiments.campaign_report.campaign_page import (
    campaign_page,
    write_campaign_page,
)

__all__ = [
    "ReportedCampaign",
    "campaign_page",
    "is_campaign",
    "read_campaigns",
    "write_campaign_page",
]
