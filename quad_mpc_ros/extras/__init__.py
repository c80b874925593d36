# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Optional parts of the package, imported only if configured or requested.

The product, all of the package except this folder, never imports this folder. Wiring
(``commands``, ``cli``, ``ros.nodes``) may import it; the product loads optional parts through the
entry points in setup.py. The folder can be deleted as a whole.
"""
