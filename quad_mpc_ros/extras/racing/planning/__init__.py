# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time-optimal plans through gates, computed before the flight (CasADi, the extra ``plan``).

May import simulation (parameters of rotors), references, control (model, config), configuration.
"""
