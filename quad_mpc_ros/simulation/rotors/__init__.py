# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``rotors``: rotors, body, battery and rate loop of a real vehicle.

The inputs are throttle and body rates, as for an autopilot. The rate loop demands a torque,
and the mixer allocates thrust and torque to the rotors, which follow with a lag.
"""
