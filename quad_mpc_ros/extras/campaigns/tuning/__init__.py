# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tuning of the controller: Optuna proposes parameters, campaigns evaluate them."""
