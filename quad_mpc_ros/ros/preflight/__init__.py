# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Preflight checks, their findings, and the facts that they read.

The checks are functions without I/O. Nodes run the checks of their own parameters when they are
configured; ``quad_mpc preflight`` runs all checks on facts that it collects over DDS.
"""
