# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Races through gates: courses, gate passages, time-optimal plans.

May import the libraries and ``control``. Enabled with ``--gates``, ``*.gates``, ``quad_mpc plan``.
"""
