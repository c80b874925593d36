# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The formulas give the same bits in Python and in compiled code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.control.lie import formulas, kernels

# Angles from none to beyond a turn, the limits between series and closed forms among them.
ANGLES = (0.0, 1e-9, 1e-4, 0.05, 0.2499999, 0.25, 0.2500001, 1.0, 3.14, 7.0)


def vectors() -> list[formulas.Vector]:
    rng = np.random.default_rng(7)
    axes = rng.normal(size=(40, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return [tuple((angle * axis).tolist()) for axis in axes for angle in ANGLES]


def quaternions() -> list[formulas.Quaternion]:
    return [tuple(q) for q in np.random.default_rng(8).normal(size=(400, 4)).tolist()]


def rotations() -> list[formulas.Matrix]:
    return [formulas.rotation(q) for q in quaternions()]


@pytest.mark.parametrize(
    ("plain", "compiled", "arguments"),
    [
        (formulas.turn_ratios, kernels._turn_ratios, [(v[0] * v[0],) for v in vectors()]),
        (formulas.polynomial, kernels._polynomial, [(v, 0.3, 0.7) for v in vectors()]),
        (formulas.rotation, kernels.rotation, [(q,) for q in quaternions()]),
        (formulas.quaternion, kernels.quaternion, [(r,) for r in rotations()]),
        (
            formulas.rotation_vector,
            kernels._rotation_vector,
            [(formulas.quaternion(kernels.exp(v)),) for v in vectors()],
        ),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_python_and_compiled_code_are_bit_identical(
    plain: Callable[..., Any], compiled: Callable[..., Any], arguments: list[tuple[Any, ...]]
) -> None:
    for each in arguments:
        assert plain(*each) == compiled(*each), each
