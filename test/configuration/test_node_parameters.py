# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the nodes: names people rely on, and what each refuses."""

from __future__ import annotations

import pytest

from quad_mpc_ros.configuration import Configuration, ConfigurationError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

NODES: dict[str, type[Configuration]] = {
    "mpc": MpcConfig,
    "simulator": SimulatorConfig,
    "reference": ReferenceConfig,
}

RELIED_ON = {
    "mpc": "control_rate formulation horizon_steps horizon_step Q R terminal_weight omega_max "
    "throttle_min throttle_max mass gravity drag motor_count thrust_curve odom_timeout "
    "reference_timeout plan_hold_time blind_time odometry.twist_frame",
    "simulator": "dynamics odom_rate lockstep mass_scale initial_position mass gravity drag "
    "motor_count thrust_curve",
    "reference": "trajectory side height dwell_time preview",
}


@pytest.mark.parametrize("node", NODES)
def test_the_names_that_scripts_rely_on_exist(node: str) -> None:
    assert set(RELIED_ON[node].split()) <= {spec.name for spec in NODES[node].specs()}


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_is_documented_and_its_default_allowed(node: str) -> None:
    for spec in NODES[node].specs():
        assert spec.doc.endswith("."), spec.name
        assert spec.validated(spec.default) == spec.default, spec.name
    NODES[node]()


@pytest.mark.parametrize(
    ("node", "values", "message"),
    [
        ("mpc", {"throttle_min": 0.3}, r"mpc\.throttle_min: given 0\.3, .* below the hover"),
        ("mpc", {"throttle_max": 0.29}, r"mpc\.throttle_max: given 0\.29, .* above the hover"),
        ("mpc", {"mass": 2.0}, r"mpc\.mass: given 2\.0, expected .* 18\.69 N"),
        ("mpc", {"thrust_curve": (-1.0, 3.0, 0.0)}, r"mpc\.thrust_curve: given \[-1\.0, 3\.0"),
        ("simulator", {"mass": 2.0}, r"simulator\.mass: given 2\.0, expected .* 18\.69 N"),
        ("simulator", {"mass_scale": 9.0}, r"simulator\.mass_scale: given 9\.0, expected "),
        (
            "simulator",
            {"initial_position": (0.0, 0.0, -0.1)},
            r"simulator\.initial_position: given \[0\.0, 0\.0, -0\.1\], .*height",
        ),
        (
            "reference",
            {"advanced.window_step": 3.0},
            r"reference\.advanced\.window_step: given 3\.0, .*and 2",
        ),
    ],
)
def test_incompatible_values_are_rejected(
    node: str, values: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=rf"^{message}"):
        NODES[node].build(values)


def test_limits_of_the_plan_change_in_flight_but_are_not_switched() -> None:
    specs = {spec.name: spec for spec in MpcConfig.specs()}
    tilt = specs["limits.tilt_max"]
    assert tilt.may_change(0.6, 0.5)
    assert tilt.may_change(0.0, 0.0)
    assert not tilt.may_change(0.0, 0.6)
    assert not tilt.may_change(0.6, 0.0)
    assert specs["advanced.limits.position_error_max"].may_change(1.5, 3.0)
    assert not specs["horizon_steps"].may_change(10, 20)
    assert specs["throttle_min"].may_change(0.0, 0.1)
