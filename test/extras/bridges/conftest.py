# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the stacks, and bridges as processes of their own."""

from fixtures.bridge_nodes import new, sound, start

__all__ = ["new", "sound", "start"]
