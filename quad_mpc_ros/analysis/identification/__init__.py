# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification of lags, delay, thrust and drag from a recorded flight.

``measurements`` extracts the data from a recording, ``fit`` fits the ``model`` to the data, and
``report`` and ``figure`` present the result. ``learned`` reads the controller's own estimates.
"""
