# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorded runs: rosbag2 directories with MCAP, written and read without ROS.

``recording`` returns the flight in a bag as arrays, ``reader`` reads any bag message by message,
``writer`` writes a bag, ``repair`` completes an interrupted bag; every failure is a ``BagError``.
``evaluation`` evaluates flights, ``replay`` plays flights or computes their commands again. May
import simulation, references, control, messages and configuration.
"""
