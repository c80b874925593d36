# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle: state, parameters, samples, and the model that predicts it."""
