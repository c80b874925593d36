# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``mujoco``: rotors, body and rate loop of the plant ``rotors``, with contacts.

MuJoCo simulates the body, its contacts with ground, deck and landing gear, and a load on a cable
(E. Todorov, T. Erez, Y. Tassa, "MuJoCo: A physics engine for model-based control", 2012).
"""
