# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Report of recorded runs: a self-contained HTML page.

:func:`read_runs` reads bags, :func:`page` makes the HTML, :func:`run_figures` the figures as
files.
"""

from quad_mpc_ros.analysis.report.page import page, run_figures
from quad_mpc_ros.analysis.report.run import ReportedRun, read_runs

__all__ = ["ReportedRun", "page", "read_runs", "run_figures"]
