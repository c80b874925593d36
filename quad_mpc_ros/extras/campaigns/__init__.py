# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many simulated flights with varied parameters: campaigns, tuning and rehearsal.

May import the libraries and ``control``. Used by ``quad_mpc campaign``, ``tune``, ``rehearse``.
"""
