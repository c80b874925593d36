# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridges to Betaflight, Crazyflie, Crazyswarm2, ROSflight and Aerostack2, registered by setup.py.

May import ``ros.bridges``, ``messages`` and lower layers. Enabled by starting the executable of
the bridge, or with ``bridge:=NAME`` in a launch file.
"""
