# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Wrong calls of the library end in one kind of error that names the argument, and in no crash."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import quad_mpc_ros
from quad_mpc_ros import Controller, MpcConfig, OdometrySample, ReferenceWindow, so3
from quad_mpc_ros.configuration.errors import ArgumentError

ANY: Any = quad_mpc_ros  # whose types these calls do not keep to
GOOD: dict[str, Any] = {
    "p_WB": np.zeros(3),
    "q_WB_xyzw": np.array([0.0, 0.0, 0.0, 1.0]),
    "v_WB_B": np.zeros(3),
    "w_WB_B": np.zeros(3),
}


@pytest.mark.parametrize("name", sorted(GOOD))
@pytest.mark.parametrize("size", [0, 2, 6])
def test_an_odometry_of_another_shape_is_refused(name: str, size: int) -> None:
    expected = len(GOOD[name])
    with pytest.raises(ArgumentError, match=f"^{name}: given .*, expected {expected} numbers$"):
        OdometrySample(stamp_ns=1, **{**GOOD, name: np.zeros(size)})


def test_nonfinite_numbers_are_handled_by_the_safety_ladder() -> None:
    odometry = OdometrySample(stamp_ns=1, **{**GOOD, "v_WB_B": np.full(3, np.nan)})
    controller = Controller(MpcConfig())
    assert controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 1.0])) is None
    (warning,) = controller.take_warnings()
    assert "not finite" in warning


@pytest.mark.parametrize(
    "given",
    [
        np.zeros((3, 2))[:, 0],
        np.broadcast_to(0.0, 3),
        np.zeros(3, dtype=np.float32),
        np.zeros(3, dtype=">f8"),
        [0, 0, 0],
        (0.0, 0.0, 0.0),
    ],
    ids=["strided", "read-only", "single precision", "big-endian", "list", "tuple"],
)
def test_converted_arguments_give_identical_results(given: Any) -> None:
    commands = []
    for rates in (GOOD["w_WB_B"], given):
        controller = Controller(MpcConfig())
        odometry = OdometrySample(stamp_ns=1, **{**GOOD, "w_WB_B": rates})
        tick = controller.step(odometry, ReferenceWindow.hover([1.0, 0.0, 1.0]))
        assert tick is not None and tick.command is not None
        commands.append((tick.command.throttle, tick.command.w_WB_B.tobytes()))
    assert commands[0] == commands[1]


def test_arguments_of_the_right_type_are_not_copied() -> None:
    odometry = OdometrySample(stamp_ns=1, **GOOD)
    assert all(getattr(odometry, name) is given for name, given in GOOD.items())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: ANY.Controller(MpcConfig()).step(None, None),
            "reference: given None, expected Ref",
        ),
        (lambda: ANY.Controller("default"), "config: given 'default', expected MpcConfig"),
        (
            lambda: ANY.MpcConfig(fence="box"),
            "mpc.fence: given 'box', expected parameters of Fence",
        ),
        (lambda: ANY.simulate("paper"), "mpc: given 'paper', expected MpcConfig"),
        (
            lambda: ANY.simulate(duration=-1.0),
            "duration: given -1.0, expected a finite number above 0",
        ),
        (
            lambda: ANY.simulate(plant=3),
            "plant: given 3, expected an object with apply, advance_to",
        ),
        (lambda: ANY.summarise({}), "flight: given {}, expected Flight"),
        (lambda: so3.exp([1.0, 2.0]), "phi: given .*, expected numbers of shape"),
        (lambda: so3.exp([np.inf, 0.0, 0.0]), "phi: given .*, expected finite numbers"),
        (
            lambda: ANY.simulate(controller=3),
            "controller: given 3, expected an object with reset, step",
        ),
        (
            lambda: ReferenceWindow.hover([0.0, 0.0, 1.0], duration=0.0),
            "duration: given 0.0, expected a finite number above 0",
        ),
    ],
)
def test_error_names_given_and_expected_values(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()
