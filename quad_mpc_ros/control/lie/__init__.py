# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The rotation group SO(3): on arrays (:mod:`so3`) and inside compiled code (:mod:`kernels`)."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of floats; docstrings state the shape."""
