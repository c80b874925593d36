"""What the tests of the controller share: the paper's flight, and inputs to disturb."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig, SolverParameters
from quad_mpc_ros.control.horizon_qp import HorizonPattern, HorizonQP, HorizonStages
from quad_mpc_ros.core.messages import OdometrySample, ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import SimulatorConfig

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]


@pytest.fixture(scope="session")
def paper_config() -> MpcConfig:
    """Return the configuration of the paper's sections 2.3 and 3, spelled out."""
    return MpcConfig(
        formulation="paper",
        control_rate=50.0,
        horizon_steps=10,
        horizon_step=0.05,
        Q=(10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.01),
        R=(0.0, 0.001, 0.001, 0.001),
        terminal_weight=1.0,
        omega_max=(6.0 * math.pi, 6.0 * math.pi, 3.0 * math.pi),
        throttle_min=0.0,
        throttle_max=1.0,
        estimate_disturbance=False,
        solver=SolverParameters(tolerance=1e-4),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedFlight:
    """A flight, and the problems that its controller solved, as many as it has steps."""

    steps: list[LoopStep]
    pattern: HorizonPattern
    problems: list[HorizonStages]


@pytest.fixture(scope="session")
def recorded_flight(paper_config: MpcConfig) -> RecordedFlight:
    """Return ten seconds of the square on a plant that moves as Eq. (3) is printed."""
    patterns: list[HorizonPattern] = []
    problems: list[HorizonStages] = []
    original = HorizonQP.update

    def update(qp: HorizonQP, stages: HorizonStages) -> None:
        if qp.pattern.steps != paper_config.horizon_steps:  # warming up
            return original(qp, stages)
        patterns.append(qp.pattern)
        problems.append(copy.deepcopy(stages))  # the next one overwrites it
        return original(qp, stages)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(HorizonQP, "update", update)
        steps = list(
            fly(
                mpc=paper_config,
                simulator=SimulatorConfig(dynamics="paper", odom_rate=50.0, duration=10.0),
                reference=ReferenceConfig(
                    trajectory="square", side=2.0, height=2.0, dwell_time=2.0, preview=False
                ),
            )
        )
    assert len(problems) == len(steps)
    return RecordedFlight(steps=steps, pattern=patterns[0], problems=problems)


@pytest.fixture(scope="session")
def paper_flight(recorded_flight: RecordedFlight) -> list[LoopStep]:
    """Return the steps of that flight."""
    return recorded_flight.steps


@pytest.fixture(scope="session")
def flown_problems(recorded_flight: RecordedFlight) -> list[HorizonStages]:
    """Return the problems of that flight."""
    return recorded_flight.problems


@pytest.fixture(scope="session")
def flown_pattern(recorded_flight: RecordedFlight) -> HorizonPattern:
    """Return the sparsity and the sizes of those problems."""
    return recorded_flight.pattern


@pytest.fixture(scope="session")
def make_odometry() -> MakeOdometry:
    """Return a maker of odometry: hovering level at (0, 0, 2) but for what is given."""

    def make(stamp_ns: int, **changes: Any) -> OdometrySample:
        hovering = OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=np.array([0.0, 0.0, 2.0]),
            q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
        )
        return dataclasses.replace(hovering, **changes)

    return make


@pytest.fixture(scope="session")
def make_window() -> MakeWindow:
    """Return a maker of windows: hover at (0, 0, 2) for two seconds but for what is given."""

    def make(stamp_ns: int, **changes: Any) -> ReferenceWindow:
        hover = ReferenceWindow(
            stamp_ns=stamp_ns,
            offset_ns=np.array([0, 2_000_000_000], dtype=np.int64),
            p_WB=np.tile([0.0, 0.0, 2.0], (2, 1)),
            q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
            v_WB_W=np.zeros((2, 3)),
            a_WB_W=np.zeros((2, 3)),
            w_WB_W=np.zeros((2, 3)),
        )
        return dataclasses.replace(hover, **changes)

    return make
