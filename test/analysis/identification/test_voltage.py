# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is fitted of the thrust over the voltage is what the battery of the plant made of it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from fixtures.knocked import knocked_about, noisy, received
from fixtures.rotors import configured, plant
from scipy.signal import lfilter

from quad_mpc_ros.analysis.identification.fit import fit
from quad_mpc_ros.analysis.identification.measurements import (
    Measurements,
    measurements_of,
)
from quad_mpc_ros.analysis.identification.model import EXPONENT, SCALE, Parameters, ResponseModel
from quad_mpc_ros.analysis.identification.report import (
    identification_table,
    parameter_file,
    proposal,
)
from quad_mpc_ros.analysis.identification.result import Identification
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.ros.bridges.config import BridgeConfig, ThrustParameters
from quad_mpc_ros.ros.bridges.thrust import ThrustMap

GIVEN = MpcConfig()
STICKS = (0.12, 4.0, 4.0, 0.3)  # yaw is weak, and airmode takes thrust for it
FULL = 16.8
DURATION, CAPACITY = 40.0, 0.0093  # which sags by 15 %


@functools.cache
def flown(
    *, seed: int = 0, duration: float = DURATION, bridge: float = 0.0, **battery: Any
) -> RecordedRun:
    """Return a flight high up that sinks as its battery sags, and what is measured of it.

    With a ``bridge`` that makes up for the voltage by what it measures, over so many volts.
    """
    changes = {f"battery__{name}": value for name, value in battery.items()}
    setup: dict[str, Any] = {
        "duration": duration,
        "seed": seed,
        "initial_position": (0.0, 0.0, 500.0),
        **changes,
    }
    thrust = ThrustMap(BridgeConfig(thrust_map=ThrustParameters(battery_voltage=bridge)))

    def passed_on(command: Any, sent: Any) -> Any:
        if sent.voltage is not None:
            thrust.receive_voltage(sent.voltage, now_ns=sent.time_ns)
        return dataclasses.replace(command, throttle=thrust.stack_throttle(command.throttle))

    flight = knocked_about(
        plant(**setup), configured(**setup), sticks=STICKS, seed=seed, passed_on=passed_on
    )
    random = np.random.default_rng(seed)
    measured_V = [
        received(each.value + 0.02 * random.standard_normal(), each.log_time_ns)
        for each in flight.voltages
    ]
    return dataclasses.replace(noisy(flight, seed=seed), voltages=measured_V)


class Truth(NamedTuple):
    """Speeds go with the voltage, thrust with their square; over the voltage as it is smoothed."""

    power: float
    scale: float


def truth(run: RecordedRun, *, reference: float) -> Truth:
    """Return the truth from voltages whose noise a straight line does not see."""
    voltage = np.array([each.value for each in run.voltages])
    time = 1e-9 * np.array([each.log_time_ns for each in run.voltages])
    share = 1.0 - math.exp(-0.2 / 2.0)
    smoothed, _ = lfilter([share], [1.0, share - 1.0], voltage, zi=[(1.0 - share) * voltage[0]])
    sagged = np.polyval(np.polyfit(time, voltage, 3), time)
    power, offset = np.polyfit(np.log(smoothed), 2.0 * np.log(sagged / FULL), 1)
    return Truth(float(power), math.exp(offset + power * math.log(reference)))


def measured(run: RecordedRun, bridge: Mapping[str, float] = MappingProxyType({})) -> Measurements:
    return measurements_of(run, vehicle=GIVEN.vehicle(), twist_frame="child", bridge=bridge)


def identified(
    run: RecordedRun, bridge: Mapping[str, float] = MappingProxyType({})
) -> Identification:
    return fit(measured(run, bridge), given=GIVEN)


def texts(found: Identification) -> tuple[str, str]:
    """Return the table, on one line, and the file."""
    table = identification_table(found, GIVEN, command_age=float("nan"))
    return " ".join(table.split()), parameter_file(found, GIVEN, bag=Path("bag"), keep="mass")


def without(run: RecordedRun) -> RecordedRun:
    return dataclasses.replace(run, voltages=[])


@pytest.mark.parametrize("seed", [0, 1])
def test_thrust_falls_with_the_square_of_the_voltage(seed: int) -> None:
    run = flown(seed=seed, capacity=CAPACITY)
    assert run.voltages[-1].value / run.voltages[0].value == pytest.approx(0.85, abs=0.02)
    found = identified(run)
    over = found.over_voltage
    assert over is not None
    true = truth(run, reference=over.reference)
    assert true.power == pytest.approx(2.0, abs=0.1)  # it lags
    assert over.falls
    assert over.exponent.value == pytest.approx(true.power, abs=over.exponent.half_width)
    assert over.exponent.half_width < 0.15
    mean = np.mean([each.value for each in run.voltages])
    assert over.reference == pytest.approx(mean, abs=0.2)
    assert found.thrust_scale.value == pytest.approx(true.scale, rel=0.02)
    if seed == 0:
        blind = identified(without(run))
        assert blind.velocity_residual > 1.2 * found.velocity_residual
        assert found.thrust_scale.half_width < blind.thrust_scale.half_width
        table, file = texts(found)
        text = f"power {over.exponent.value:.2f} at {over.reference:.2f} V, battery_exponent"
        assert f"thrust over voltage: {text} and battery_voltage of the bridge" in table
        thrust_map = yaml.safe_load(file)["/**"]["ros__parameters"]["thrust_map"]
        assert thrust_map == {
            "battery_voltage": pytest.approx(over.reference, abs=0.01),
            "battery_exponent": pytest.approx(over.exponent.value, abs=0.01),
        }


def test_estimates_zero_exponent_if_the_autopilot_compensates() -> None:
    found = identified(flown(capacity=CAPACITY, compensated=True))
    over = found.over_voltage
    assert over is not None
    assert over.exponent.observable
    assert over.exponent.value == pytest.approx(0.0, abs=over.exponent.half_width)
    assert found.thrust_scale.value == pytest.approx(1.0, rel=0.02)
    table, file = texts(found)
    assert "not significant: leave thrust_map.battery_voltage of the bridge at 0" in table
    assert "thrust_map" not in file


def test_exponent_includes_the_compensation_of_the_bridge() -> None:
    """Without the map nothing is left; with it, it is what the bridge should go on doing."""
    run = flown(capacity=CAPACITY, bridge=16.0)
    without_map = identified(run).over_voltage
    assert without_map is not None
    assert without_map.exponent.value == pytest.approx(0.0, abs=0.1)
    bridge = {"thrust_map.battery_voltage": 16.0, "thrust_map.battery_exponent": 2.0}
    found = identified(run, bridge)
    over = found.over_voltage
    assert over is not None
    assert over.reference == 16.0
    true = truth(run, reference=16.0)
    assert over.exponent.value == pytest.approx(true.power, abs=over.exponent.half_width + 0.02)
    assert found.thrust_scale.value == pytest.approx(true.scale, rel=0.02)


def test_smooths_the_voltage_like_the_bridges() -> None:
    run = flown(duration=8.0, capacity=CAPACITY)
    thrust = ThrustMap(BridgeConfig(thrust_map=ThrustParameters(battery_voltage=FULL)))
    for each in run.voltages:
        thrust.receive_voltage(each.value, now_ns=each.log_time_ns)
    smoothed = measured(run).voltage[-1]
    assert (smoothed / FULL) ** 2 == pytest.approx(thrust.battery_scale, rel=1e-12)
    assert smoothed != pytest.approx(run.voltages[-1].value, abs=0.01)


@pytest.mark.parametrize("fault", ["no number", "silent"])
def test_ignores_a_voltage_with_gaps(fault: str) -> None:
    run = flown(duration=8.0, capacity=CAPACITY)
    voltages = {
        "no number": [received(math.nan, each.log_time_ns) for each in run.voltages],
        "silent": run.voltages[:5],
    }[fault]
    found = identified(dataclasses.replace(run, voltages=voltages))
    before = identified(without(run))
    assert found.over_voltage is None
    assert texts(found) == texts(before)
    for name in ("thrust_scale", "drag", "rate_residual", "velocity_residual", "misfit"):
        assert getattr(found, name) == getattr(before, name)
    assert "thrust by" not in texts(found)[0]


def test_a_constant_voltage_changes_no_other_estimate() -> None:
    run = flown(duration=15.0)
    assert not run.voltages  # a battery that never sags has none
    steady = [received(16.0 + 0.02 * (k % 2), o.log_time_ns) for k, o in enumerate(run.odometries)]
    found, before = identified(dataclasses.replace(run, voltages=steady)), identified(run)
    over = found.over_voltage
    assert over is not None
    assert not over.exponent.seen
    assert found.thrust_scale.value == pytest.approx(before.thrust_scale.value, rel=1e-4)
    assert found.thrust_scale.half_width == pytest.approx(before.thrust_scale.half_width, rel=0.02)
    table, file = texts(found)
    assert (
        "thrust by (V/16.01 V)^n cannot be identified from this flight: the voltage hardly"
        in table
    )
    assert "thrust_map" not in file
    # A battery needs another flight than the one that is proposed.
    assert proposal(found, GIVEN, file=None) == proposal(before, GIVEN, file=None)


def test_refuses_an_exponent_at_a_bound() -> None:
    """A sensor that shows a fifth of the sag."""
    run = flown(capacity=CAPACITY)
    little = [received(16.0 + 0.2 * (v.value - 16.0), v.log_time_ns) for v in run.voltages]
    found, blind = identified(dataclasses.replace(run, voltages=little)), identified(without(run))
    over = found.over_voltage
    assert over is not None
    assert over.exponent.at_bound
    assert not over.falls
    table = identification_table(found, GIVEN, command_age=float("nan"))
    assert "was estimated as 4.000, the end of the search range" in " ".join(table.split())
    # Held as without a voltage.
    assert found.velocity_residual == pytest.approx(blind.velocity_residual, rel=1e-3)
    assert found.thrust_scale.value == pytest.approx(blind.thrust_scale.value, rel=1e-3)


def test_derivatives_match_finite_differences_of_the_residuals() -> None:
    model = ResponseModel(measured(flown(duration=8.0, capacity=CAPACITY)))
    assert model.parameters == EXPONENT + 1
    parameters = Parameters.zeros(1)
    given = parameters[0]
    given.rate_tau[:], given.rate_gain[:] = (0.02, 0.02, 0.15), (1.0, 1.1, 0.9)
    given.thrust_tau = given.delay = 0.01
    given.linear.scale, given.linear.lift = 0.9, 0.01
    given.linear.drag[:], given.linear.rotor_drag[:] = (0.2, 0.1, 0.3), (0.3, 0.2, 0.1)
    given.linear.acceleration[:], given.exponent = (0.1, -0.1), 1.7
    theta = np.asarray(parameters).view(np.float64)
    _, by = model.jacobians(theta)
    for parameter in range(SCALE, EXPONENT + 1):
        above, below = theta.copy(), theta.copy()
        above[parameter] += 1e-5
        below[parameter] -= 1e-5
        slope = (model.residuals(above)[1] - model.residuals(below)[1]) / 2e-5
        assert by[:, :, parameter] == pytest.approx(slope, abs=1e-8), parameter
