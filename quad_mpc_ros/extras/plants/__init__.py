# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Plants that need additional packages: MuJoCo, real Betaflight firmware, rotorpy.

May import ``simulation`` and lower layers, and ``messages``; ``simulation`` declares their
parameters. Select one with ``--plant NAME`` or ``simulator.plant``; setup.py registers them.
"""
