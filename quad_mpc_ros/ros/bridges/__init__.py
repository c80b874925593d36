# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bridges to flight stacks: messages and rules of each stack in one file, and one node for all."""
