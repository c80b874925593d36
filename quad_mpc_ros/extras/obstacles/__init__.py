# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles: files, messages, map, avoidance and a simulated sensor.

May import ``simulation`` (shapes), ``messages`` and ``control``. :mod:`.avoidance` is the guide.
Enabled with ``mpc.obstacles.half_spaces``, ``simulator.obstacles.file`` or ``--obstacles``.
"""
