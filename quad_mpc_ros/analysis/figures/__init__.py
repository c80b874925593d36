# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of flights and references. Matplotlib is imported only when something is drawn."""

from quad_mpc_ros.analysis.figures.over_time import write_figures

__all__ = ["write_figures"]
