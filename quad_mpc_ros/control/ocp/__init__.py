# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem: the two formulations, the sparse QP, and OSQP."""
