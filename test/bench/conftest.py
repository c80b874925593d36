# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Initial states and short flights, for tests of the comparison."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.presets import agile, ideal

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

STAMP_NS = 1_000_000_000
_SAMPLES = 41
_STEP_NS = 50_000_000
_VELOCITY_W = np.array([3.0, -2.0, 0.5])


@pytest.fixture(scope="session")
def mpc() -> MpcConfig:
    """Return a configuration whose every weight matters, the terminal one too."""
    return agile(
        estimate_disturbance=False,  # which the peers have not
        formulation="manifold",
        horizon_steps=10,
        horizon_step=0.05,
        Q=(10.0, 9.0, 8.0, 1.0, 1.5, 2.0, 0.1, 0.2, 0.3),
        R=(0.5, 0.02, 0.03, 0.04),
        terminal_weight=5.0,
        lockstep=True,
    )


@pytest.fixture(scope="session")
def odometries() -> list[OdometrySample]:
    """Return a few states near the start of the reference, tilted and moving."""
    random = np.random.default_rng(7)
    attitudes = so3.exp(0.3 * random.normal(size=(6, 3)))
    return [
        OdometrySample(
            stamp_ns=STAMP_NS,
            p_WB=0.4 * random.normal(size=3),
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=R_WB.T @ (_VELOCITY_W + 0.4 * random.normal(size=3)),
            w_WB_B=random.normal(size=3),
        )
        for R_WB in attitudes
    ]


@pytest.fixture(scope="session")
def window() -> ReferenceWindow:
    """Return a reference that climbs, drifts and turns about the vertical."""
    offset_ns = np.arange(_SAMPLES, dtype=np.int64) * _STEP_NS
    seconds = 1e-9 * offset_ns
    turning = np.array([0.0, 0.0, 0.8])
    return ReferenceWindow(
        stamp_ns=STAMP_NS,
        offset_ns=offset_ns,
        p_WB=np.outer(seconds, _VELOCITY_W),
        q_WB_xyzw=so3.quaternion_xyzw_from_rotation(so3.exp(np.outer(seconds, turning))),
        v_WB_W=np.tile(_VELOCITY_W, (_SAMPLES, 1)),
        a_WB_W=np.zeros((_SAMPLES, 3)),
        w_WB_W=np.tile(turning, (_SAMPLES, 1)),
    )


@pytest.fixture(scope="session")
def simulator() -> SimulatorConfig:
    return ideal(dynamics="rigid_body", duration=1.5, lockstep=True)


@pytest.fixture(scope="session")
def reference() -> ReferenceConfig:
    """Return the square with a switch within the flight."""
    return ReferenceConfig(trajectory="square", dwell_time=1.0, lockstep=True)
