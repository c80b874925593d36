# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimation in flight: delay compensation, EKF of motion and parameters, landing detection."""
