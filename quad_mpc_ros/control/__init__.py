# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller: the control step (:mod:`.controller`, :mod:`.mpc`), safety, estimation, ocp,
model and lie. No I/O; times are arguments. Imports configuration only.
"""
