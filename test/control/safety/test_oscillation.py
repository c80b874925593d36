# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The detector of oscillations ends limit cycles and ignores other flights."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.presets import agile, ideal
from scipy.spatial.transform import Rotation

from quad_mpc_ros import load_config, simulate, summarise
from quad_mpc_ros.control.config import ConsistencyParameters, OscillationParameters
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety import oscillation
from quad_mpc_ros.control.safety.ladder import Action
from quad_mpc_ros.control.safety.oscillation import OscillationMonitor
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
PERIOD_NS = 20_000_000
# None of these lags is modelled.
LATE = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03, "command_delay": 0.02}


def odometry(attitude: Rotation, *, now_ns: int) -> OdometrySample:
    return OdometrySample(
        stamp_ns=now_ns,
        p_WB=np.zeros(3),
        q_WB_xyzw=attitude.as_quat(),
        v_WB_B=np.zeros(3),
        w_WB_B=np.zeros(3),
    )


def breaches(
    monitor: OscillationMonitor,
    *,
    amplitude: float,
    frequency: float,
    seconds: float,
    about: Rotation | None = None,
) -> list[int]:
    """Return the ticks with a breach while it oscillates about the reference's attitude."""
    asked = about or Rotation.identity()
    found = []
    for tick in range(round(seconds * 50)):
        now_ns = tick * PERIOD_NS
        lean = amplitude * math.sin(2.0 * math.pi * frequency * 1e-9 * now_ns)
        attitude = Rotation.from_rotvec([lean, 0.0, 0.0]) * asked
        reference = np.zeros(3), asked.as_quat()
        breach = monitor.check(odometry(attitude, now_ns=now_ns), reference, now_ns=now_ns)
        if breach is not None:
            assert breach.action is Action.HOVER
            found.append(tick)
    return found


@pytest.mark.parametrize("about", [Rotation.identity(), Rotation.from_euler("yz", [0.7, 2.0])])
def test_detects_oscillation_within_three_seconds_and_holds(about: Rotation) -> None:
    found = breaches(
        OscillationMonitor(agile()), amplitude=0.3, frequency=1.5, seconds=4.0, about=about
    )
    assert 50 < found[0] < 150
    assert found == [*range(found[0], 200)]


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.15, 2.0), (0.6, 0.5), (0.0, 1.0)])
def test_ignores_small_or_slow_oscillation(amplitude: float, frequency: float) -> None:
    assert not breaches(
        OscillationMonitor(agile()), amplitude=amplitude, frequency=frequency, seconds=20.0
    )


def test_holds_repeated_oscillations_three_times_as_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(oscillation, "_HOLD_NS", 1_000_000_000)
    monitor = OscillationMonitor(agile())
    found = np.array(breaches(monitor, amplitude=0.3, frequency=2.0, seconds=30.0))
    ends = np.flatnonzero(np.diff(found) > 1)
    begins = found[np.insert(ends + 1, 0, 0)]
    held = found[ends] - begins[:-1] + 1
    assert np.array_equal(held, 50 * 3 ** np.arange(len(held)))
    assert len(held) == 3


def test_ignores_oscillation_under_a_pilot() -> None:
    monitor = OscillationMonitor(agile())
    assert breaches(monitor, amplitude=0.3, frequency=1.5, seconds=5.0)
    monitor.engage(False)
    assert not breaches(monitor, amplitude=0.6, frequency=1.5, seconds=5.0)
    monitor.engage(True)
    assert not breaches(monitor, amplitude=0.0, frequency=1.0, seconds=5.0), "nothing is held"


@pytest.mark.parametrize(
    "reference",
    [
        {"trajectory": "square"},
        {"trajectory": "lemniscate", "angular_frequency": 2.6},
        {"trajectory": "flip"},
        {"trajectory": "vertical_loop"},
    ],
    ids=lambda reference: reference["trajectory"],
)
def test_agile_flight_is_neither_an_oscillation_nor_a_crash(reference: dict[str, Any]) -> None:
    lags = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03}
    steps = fly(
        mpc=agile(**lags, input_delay=0.02),
        simulator=ideal(**lags, command_delay=0.02, duration=12.0),
        reference=ReferenceConfig(**reference),
        on_reference=True,
    )
    assert {step.tick.stats.source for step in steps if step.tick is not None} == {"mpc"}


def fly_delayed(action: str) -> list[LoopStep]:
    start = {"initial_position": (0.4, -0.3, 2.2), "initial_throttle": 0.3}
    return [
        *fly(
            mpc=agile(
                oscillation=OscillationParameters(action=action),
                consistency=ConsistencyParameters(action="warn"),
            ),
            simulator=ideal(**LATE, **start, duration=10.0),
            reference=ReferenceConfig(trajectory="hover", height=2.0),
        )
    ]


def test_detects_oscillation_of_delayed_vehicle() -> None:
    """Without the monitor this vehicle crashes."""
    caught, lost = fly_delayed("hover"), fly_delayed("warn")
    assert max(tilt(step) for step in lost[-100:]) > math.radians(60.0)
    assert max(tilt(step) for step in caught[-100:]) < math.radians(15.0)
    assert min(float(step.truth.p_WB[2]) for step in caught) > 1.0


def tilt(step: LoopStep) -> float:
    return math.acos(min(max(step.truth.up, -1.0), 1.0))


def test_ignores_a_reference_whose_tilt_jumps_from_side_to_side() -> None:
    """Paths around obstacles cause such references: the tilt changes its side at once."""
    monitor = OscillationMonitor(agile())
    attitude, position = 0.0, np.zeros(3)
    for tick in range(300):
        asked = 0.4 * (1.0 if tick // 12 % 2 else -1.0)
        attitude += 0.3 * (asked - attitude)
        now_ns, leaning = tick * PERIOD_NS, Rotation.from_rotvec([attitude, 0.0, 0.0])
        reference = position, Rotation.from_rotvec([asked, 0.0, 0.0]).as_quat()
        assert monitor.check(odometry(leaning, now_ns=now_ns), reference, now_ns=now_ns) is None


def test_solves_among_pillars_in_few_iterations() -> None:
    """The largest number of 500 steps varies from start to start by a third."""
    pillars = EXAMPLES / "pillars.yaml"
    files = [f"{node}.obstacles.file={pillars}" for node in ("simulator", "mpc")]
    flight = simulate(
        *load_config(assignments=[*files, "mpc.obstacles.half_spaces=8"]), duration=10.0
    )
    found = summarise(flight)
    assert found["solver_failures"] == 0
    assert found["iterations"]["p99"] <= 200
    assert found["iterations"]["max"] <= 450
