# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification recovers the parameters of the simulator from its flights."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.knocked import START_NS, STICKS, changed, knocked_about, noisy, received
from fixtures.presets import ideal
from scipy.integrate import quad, solve_ivp

from quad_mpc_ros.analysis.identification.figure import write_fit_figure
from quad_mpc_ros.analysis.identification.fit import fit, identify
from quad_mpc_ros.analysis.identification.lag import LaggedCommands
from quad_mpc_ros.analysis.identification.measurements import Measurements, measurements_of
from quad_mpc_ros.analysis.identification.report import (
    identification_table,
    parameter_file,
    proposal,
)
from quad_mpc_ros.analysis.identification.result import FittedCourse, Identification
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.configuration import BagError, UserError, files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.recordings.logs import Received
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.run import RecordedRun
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.internal_plant import InternalPlant

TRUTH = {
    "rate_time_constant": 0.03,
    "thrust_time_constant": 0.04,
    "command_delay": 0.02,
    "mass_scale": 1.2,
}


@functools.cache
def flown(
    *, duration: float = 15.0, lively: float = 1.0, seed: int = 0, **simulator: object
) -> RecordedRun:
    """Return a flight of the internal plant."""
    hover = ideal(simulator).vehicle().hover_throttle
    config = ideal(
        {
            "duration": duration,
            "initial_position": (0.0, 0.0, 50.0),
            "initial_throttle": hover,
            "seed": seed,
            **simulator,
        }
    )
    sticks = lively * np.array(STICKS)
    return knocked_about(InternalPlant(config), config, sticks=sticks, seed=seed)


def resent(each: Received, **changes: Any) -> Received:
    """Return a received message with other values."""
    return dataclasses.replace(each, value=dataclasses.replace(each.value, **changes))


def measured(run: RecordedRun) -> Measurements:
    return measurements_of(run, vehicle=MpcConfig().vehicle(), twist_frame="child")


GIVEN = MpcConfig(rate_time_constant=0.0, thrust_time_constant=0.0, input_delay=0.0, drag=0.2)


def identified(run: RecordedRun) -> Identification:
    return fit(measured(run), given=GIVEN)


def assert_near(
    found: Identification,
    *,
    relative: float,
    delay: float = 0.02,
    drag: float = 0.2,
    drag_within: float | None = None,
) -> None:
    near = [
        *((estimate, 0.03) for estimate in found.rate_time_constant),
        *((estimate, 1.0) for estimate in found.rate_gain),
        (found.thrust_time_constant, 0.04),
        (found.input_delay, delay),
        (found.thrust_scale, 1.0 / 1.2),
    ]
    for estimate, truth in near:
        assert estimate.observable, truth
        assert estimate.value == pytest.approx(truth, rel=relative), truth
    for estimate in found.drag:
        assert estimate.value == pytest.approx(drag, rel=drag_within or relative)


@pytest.mark.parametrize(
    ("time_constant", "torque"),
    [(0.0, 0.0), (0.03, 0.0), (0.5, 0.0), (0.1, 0.02), (0.08, 0.02), (0.03, 0.1)],
)
def test_lagged_response_solves_the_differential_equation(
    time_constant: float, torque: float
) -> None:
    time = np.array([0.0, 0.02, 0.05, 0.3])
    command = np.array([[1.0], [3.0], [-2.0], [0.5]])
    lag = LaggedCommands(time, command, time_constant=time_constant, torque_time_constant=torque)

    def wanted(t: float) -> float:
        held = command[max(int(np.searchsorted(time, t, side="right")) - 1, 0), 0]
        if time_constant == 0.0:
            return float(held)
        y = np.array([1.0, 0.0])

        def slope(_: float, y: Array, target: float) -> Array:
            rise = (target - y[0]) / time_constant
            return np.array([y[1], (rise - y[1]) / torque] if torque else [rise, 0.0])

        for begin, end, target in zip(time, [*time[1:], 10.0], command[:, 0], strict=True):
            if t <= begin:
                break
            y = solve_ivp(
                slope, (begin, min(t, end)), y, args=(target,), rtol=1e-10, atol=1e-12
            ).y[:, -1]
        return float(y[0])

    asked = np.array([0.01, 0.021, 0.049, 0.12, 0.4])
    assert lag.at(asked)[:, 0] == pytest.approx([wanted(t) for t in asked], abs=1e-8)
    mean, mean_square = lag.means(np.array([0.06]), np.array([0.2]))
    points = {"points": [0.061, 0.07, 0.1]}
    assert mean[0, 0] == pytest.approx(quad(wanted, 0.06, 0.26, **points)[0] / 0.2, abs=1e-6)
    if not torque:
        assert mean_square[0, 0] == pytest.approx(
            quad(lambda t: wanted(t) ** 2, 0.06, 0.26, **points)[0] / 0.2, abs=1e-6
        )


def explained(course: FittedCourse) -> float:
    """Return the share of the measured variation that the fit explains, at most 1."""
    varied = np.sum((course.measured - course.measured.mean(axis=0)) ** 2)
    return float(1.0 - np.sum((course.measured - course.fitted) ** 2) / varied)


@pytest.mark.parametrize("torque", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("odom_rate", [50.0, 200.0])
def test_finds_the_simulated_vehicle_exactly_without_noise(
    odom_rate: float, torque: float
) -> None:
    """Loops of first order, and of damping 0.5 and 0.27."""
    vehicle = {**TRUTH, "torque_time_constant": torque, "drag": 0.3}
    found = identified(flown(**vehicle, odom_rate=odom_rate, duration=10.0))
    assert_near(found, relative=0.01, drag=0.3, drag_within=0.03)
    for estimate in found.torque_time_constant:
        assert estimate.value == pytest.approx(torque, rel=0.01, abs=2e-4)
    assert explained(found.rates) > 0.999


def test_ignores_commands_that_were_not_executed() -> None:
    """For four seconds another flies, while the controller goes on commanding."""
    run = flown(**TRUTH, duration=15.0)
    released_ns, engaged_ns = START_NS + 5_000_000_000, START_NS + 9_000_000_000
    commands = [
        resent(command, throttle=1.0 - command.value.throttle, w_WB_B=-command.value.w_WB_B)
        if released_ns <= command.log_time_ns < engaged_ns
        else command
        for command in run.commands
    ]
    unknown = changed(run, commands=commands)
    known = dataclasses.replace(
        unknown,
        engagements=[
            received(True, START_NS),
            received(False, released_ns),
            received(True, engaged_ns),
        ],
    )
    assert explained(identified(unknown).rates) < 0.9
    assert_near(identified(known), relative=0.02, drag_within=0.05)
    with pytest.raises(BagError, match="commands were active for 0% of them"):
        identified(changed(run, engagements=[received(False, START_NS)]))


@pytest.mark.parametrize(
    "trouble",
    [
        {"odom_dropout": 0.1, "odom_jitter": 0.003},
        {"wind": (3.0, -2.0, 0.0), "gust_intensity": 0.7},
    ],
    ids=["losses and jitter", "wind and gusts"],
)
def test_noise_losses_and_wind_change_estimates_by_at_most_a_tenth(
    trouble: dict[str, object],
) -> None:
    found = identified(noisy(flown(**TRUTH, **trouble)))
    assert_near(found, relative=0.1, drag_within=0.5)


def test_distinguishes_wind_from_drag() -> None:
    found = identified(flown(**TRUTH, wind=(4.0, -2.0, 0.0)))
    assert found.wind_acceleration_W == pytest.approx([0.8, -0.4], abs=0.02)
    assert found.drag[0].value == pytest.approx(0.2, rel=0.03)


def test_the_delay_counts_from_the_stamp_of_the_odometry() -> None:
    # Sent 15 ms after it was measured, answered at once, acting 20 ms later.
    found = identified(noisy(flown(**TRUTH, odom_delay=0.015)))
    assert_near(found, relative=0.1, delay=0.035, drag_within=0.5)


def test_estimates_zero_lags_without_lags() -> None:
    found = identified(noisy(flown()))
    for estimate in (
        *found.rate_time_constant,
        found.thrust_time_constant,
        found.input_delay,
    ):
        assert estimate.seen
        assert abs(estimate.value) <= min(estimate.half_width, 0.005)
    assert found.thrust_scale.value == pytest.approx(1.0, rel=0.01)


def test_is_robust_to_single_outliers() -> None:
    run = noisy(flown(**TRUTH))
    odometries = list(run.odometries)
    for i in range(100, 700, 40):
        odometries[i] = resent(
            odometries[i],
            v_WB_B=odometries[i].value.v_WB_B + np.array((5.0, 0.0, -5.0)),
            w_WB_B=odometries[i].value.w_WB_B + 10.0,
        )
    assert_near(identified(changed(run, odometries=odometries)), relative=0.1, drag_within=0.6)


def test_rotates_a_twist_in_the_world_frame() -> None:
    run = flown(**TRUTH)
    turned = []
    for received_odometry in run.odometries:
        odometry = received_odometry.value
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        v_WB_W, w_WB_W = R_WB @ odometry.v_WB_B, R_WB @ odometry.w_WB_B
        turned.append(resent(received_odometry, v_WB_B=v_WB_W, w_WB_B=w_WB_W))
    data = measurements_of(
        changed(run, odometries=turned),
        vehicle=MpcConfig().vehicle(),
        twist_frame="world",
    )
    assert_near(fit(data, given=GIVEN), relative=0.01, drag_within=0.05)


def test_hover_identifies_only_the_thrust() -> None:
    run = flown(**TRUTH, lively=0.0)
    found = identified(run)
    assert found.thrust_scale.observable
    assert found.thrust_scale.value == pytest.approx(1.0 / 1.2, rel=0.01)
    unseen = (
        *found.rate_time_constant,
        *found.rate_gain,
        found.thrust_time_constant,
        found.input_delay,
        *found.drag,
        found.translational_lift,
    )
    assert not any(estimate.seen for estimate in unseen)
    given = MpcConfig(rate_time_constant=(0.05, 0.05, 0.1), thrust_time_constant=0.04, drag=0.3)
    text = " ".join(identification_table(found, given, command_age=float("nan")).split())
    assert "warning: thrust_time_constant cannot be identified" in text
    assert "warning: drag x, drag y, drag z cannot be identified" in text
    assert proposed(found, given)["reference"].excitation_reach == (6.0, 6.0, 2.0)
    text = parameter_file(found, given, bag=Path("bag"), keep="mass")
    assert "    rate_time_constant: [0.05, 0.05, 0.1]  # kept, not observable\n" in text
    assert "    thrust_time_constant: 0.04  # kept, not observable\n" in text
    assert "    drag: 0.3  # kept, not observable\n" in text


def proposed(found: Identification, given: MpcConfig) -> dict[str, Any]:
    """Return the configuration of the flight that is proposed, which can be flown."""
    words = shlex.split(" ".join(proposal(found, given, file=None)[2:]).replace("\\\n", " "))
    assert words[:2] == ["quad_mpc", "fly"]
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    options = parser.parse_args(words[2:])
    settings = [f"reference.trajectory={options.reference}", *options.assignments]
    schema = {"mpc": MpcConfig, "reference": ReferenceConfig}
    config = files.load([], settings, schema=schema)
    reference = config["reference"]
    assert isinstance(reference, ReferenceConfig)
    assert options.duration > 1e-9 * configured_trajectory(reference).period_ns
    return config


def test_proposes_a_flight_only_for_missing_parameters() -> None:
    found = identified(noisy(flown(**TRUTH)))
    sure = dataclasses.replace(found.drag[0], observable=True)
    complete = dataclasses.replace(
        found, drag=(sure, sure, sure), translational_lift=sure, misfit=(0.0, 0.0)
    )
    assert proposal(complete, GIVEN, file=Path("found.yaml")) == []
    unsure = dataclasses.replace(found.input_delay, observable=False)
    no_delay = dataclasses.replace(complete, input_delay=unsure)
    assert proposed(no_delay, GIVEN)["reference"].excitation_reach == (2.0, 2.0, 1.0)
    assert "--config found.yaml" in proposal(no_delay, GIVEN, file=Path("found.yaml"))[-1]


def test_ignores_data_on_the_ground() -> None:
    run = noisy(flown(**TRUTH))
    first = run.odometries[0].value
    resting = dataclasses.replace(first, v_WB_B=np.zeros(3), w_WB_B=np.zeros(3))
    ground, idle = [], []
    for k in range(200):
        stamp_ns = first.stamp_ns - (200 - k) * 20_000_000
        ground.append(received(dataclasses.replace(resting, stamp_ns=stamp_ns), stamp_ns))
        # Commands that would roll it over if it flew.
        command = CommandSample(stamp_ns=stamp_ns, throttle=0.1, w_WB_B=np.full(3, (-1.0) ** k))
        idle.append(received(command, stamp_ns))
    whole = changed(run, odometries=[*ground, *run.odometries], commands=[*idle, *run.commands])
    assert not measured(whole).usable[:200].any()
    assert_near(identified(whole), relative=0.1, drag_within=0.6)


@pytest.mark.parametrize("keep", ["mass", "curve"])
def test_parameter_file_describes_the_identified_vehicle(keep: str, tmp_path: Path) -> None:
    found = identified(flown(**TRUTH))
    path = tmp_path / "vehicle.yaml"
    path.write_text(parameter_file(found, MpcConfig(), bag=Path("bag"), keep=keep))
    loaded = files.load([str(path)], [], schema={"mpc": MpcConfig, "reference": ReferenceConfig})
    mpc, reference = loaded["mpc"], loaded["reference"]
    assert isinstance(mpc, MpcConfig)
    assert isinstance(reference, ReferenceConfig)
    assert reference.vehicle() == mpc.vehicle()
    true = ideal(TRUTH).vehicle()
    assert mpc.vehicle().hover_throttle == pytest.approx(true.hover_throttle, rel=0.01)
    assert mpc.mass == pytest.approx(MpcConfig().mass * (1.0 if keep == "mass" else 1.2), rel=0.01)
    assert mpc.rate_time_constant == pytest.approx((0.03, 0.03, 0.03), rel=0.01)
    assert mpc.input_delay == pytest.approx(0.02, rel=0.01)


def test_refuses_rates_of_another_flight(tmp_path: Path) -> None:
    run, other = flown(**TRUTH), flown(seed=1)
    found = identified(changed(run, commands=other.commands))
    table = identification_table(found, MpcConfig(), command_age=float("nan"))
    assert "is unexplained beyond noise" in " ".join(table.split())
    # What it came to is of no use for the next flight.
    assert "--config" not in "".join(proposal(found, MpcConfig(), file=tmp_path / "vehicle.yaml"))
    assert proposed(found, MpcConfig())["reference"].trajectory == "excitation"
    with pytest.raises(UserError, match=r"nothing is written: \d+% of the variation of the body"):
        parameter_file(found, MpcConfig(), bag=Path("bag"), keep="mass")
    figure = write_fit_figure(found, tmp_path / "fit.png")
    assert figure.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_refuses_a_flight_that_is_too_short() -> None:
    run = flown(duration=4.0)
    with pytest.raises(BagError, match="longer flight"):
        identified(run)
    with pytest.raises(BagError, match="0 commands"):
        measured(changed(run, commands=[]))
    with pytest.raises(BagError, match="10 usable odometries"):
        measured(changed(run, odometries=run.odometries[:10]))
    long_ago = [resent(each, stamp_ns=each.value.stamp_ns % 10**9) for each in run.commands]
    with pytest.raises(BagError, match="stamped"):
        measured(changed(run, commands=long_ago[:40]))


def test_is_robust_to_invalid_values_and_clock_steps() -> None:
    run = flown(**TRUTH)
    commands = list(run.commands)
    for i, throttle, rate in ((50, np.nan, 0.0), (150, 0.3, 1e300), (250, -np.inf, np.inf)):
        commands[i] = resent(commands[i], throttle=throttle, w_WB_B=np.full(3, rate))
    before = [resent(run.odometries[k], stamp_ns=k * 20_000_000) for k in range(20)]
    late, later = (
        [resent(each, stamp_ns=each.value.stamp_ns + 2_000_000_000 * 10**9) for each in sent]
        for sent in (run.odometries, commands)
    )
    whole = changed(run, odometries=[*before, *late], commands=later)
    found = identified(whole)
    assert found.rate_time_constant[0].value == pytest.approx(0.03, rel=0.1)
    assert found.thrust_scale.value == pytest.approx(1.0 / 1.2, rel=0.1)


EACH_AXIS = {
    "rate_time_constant": (0.03, 0.04, 0.1),
    "thrust_time_constant": 0.04,
    "command_delay": 0.02,
    "mass_scale": 1.2,
    "drag": (0.35, 0.2, 0.55),
    "translational_lift": 0.015,
}
ROTORS = {"drag": (0.1, 0.1, 0.2), "rotor_drag": (0.4, 0.3, 0.6)}
THE_TRUTH = {
    "rate_time_constant": EACH_AXIS["rate_time_constant"],
    "rate_gain": (1.0, 1.0, 1.0),
    "thrust_time_constant": (0.04,),
    "input_delay": (0.02,),
    "thrust_scale": (1.0 / 1.2,),
    "drag": EACH_AXIS["drag"],
    "translational_lift": (0.015,),
}


def off(found: Identification) -> dict[str, list[tuple[float, float]]]:
    """Return how far each number is off, and half of the interval that it claims."""
    errors = {}
    for name, truth in THE_TRUTH.items():
        estimates = getattr(found, name)
        estimates = estimates if isinstance(estimates, tuple) else (estimates,)
        assert all(estimate.observable for estimate in estimates), name
        errors[name] = [
            (abs(estimate.value - value), estimate.half_width)
            for estimate, value in zip(estimates, truth, strict=True)
        ]
    return errors


@functools.cache
def each_axis_identified(seed: int) -> Identification:
    """Return what is found in twenty noisy seconds."""
    return identified(noisy(flown(**EACH_AXIS, duration=20.0, seed=seed), seed=seed))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_twenty_noisy_seconds_identify_drag_and_lag_of_each_axis(seed: int) -> None:
    """Within twice of the intervals: one of twenty is outside of its own."""
    errors = off(each_axis_identified(seed))
    assert all(error <= 2.0 * width for each in errors.values() for error, width in each)
    lags = (*errors["rate_time_constant"], *errors["thrust_time_constant"], *errors["input_delay"])
    assert all(width <= 0.004 for _, width in lags)
    assert all(width <= 0.03 for _, width in errors["drag"])


def test_distinguishes_rotor_drag_from_body_drag() -> None:
    """The thrust varies with the speed; there is no noise, which would hide the drag."""
    found = identified(flown(**{**EACH_AXIS, **ROTORS}, duration=20.0, lively=1.5))
    for name, truth in ROTORS.items():
        estimates = getattr(found, name)
        assert all(estimate.observable for estimate in estimates), name
        assert [estimate.value for estimate in estimates] == pytest.approx(truth, abs=0.05), name
    text = parameter_file(found, GIVEN, bag=Path("bag"), keep="mass")
    written = yaml.safe_load(text)["/**"]["ros__parameters"]["rotor_drag"]
    assert written == pytest.approx(ROTORS["rotor_drag"], abs=0.05)
    assert "rotor_drag x [1/s]" in identification_table(found, GIVEN, command_age=float("nan"))


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_estimated_as_rotor_drag(seed: int) -> None:
    """The estimates before the drag is fixed are not used either."""
    found = each_axis_identified(seed)
    assert not any(estimate.observable for estimate in found.rotor_drag)
    assert "rotor_drag" not in identification_table(found, GIVEN, command_age=float("nan"))
    text = parameter_file(found, GIVEN, bag=Path("bag"), keep="mass")
    assert "    rotor_drag: 0.0  # kept, not observable\n" in text


def test_writes_small_numbers_as_yaml_numbers() -> None:
    """YAML takes 1e-07 for text."""
    found = each_axis_identified(0)
    little = dataclasses.replace(found.drag[0], value=1.2e-7, observable=True)
    found = dataclasses.replace(found, drag=(little, *found.drag[1:]))
    text = parameter_file(found, GIVEN, bag=Path("bag"), keep="mass")
    assert yaml.safe_load(text)["/**"]["ros__parameters"]["drag"][0] == pytest.approx(1e-7)


def test_identifies_the_gain_of_a_rate_loop() -> None:
    found = identified(noisy(flown(**TRUTH, rate_gain=(0.9, 1.0, 0.8))))
    gains = [estimate.value for estimate in found.rate_gain]
    assert gains == pytest.approx([0.9, 1.0, 0.8], abs=0.01)
    assert [e.value for e in found.rate_time_constant] == pytest.approx([0.03] * 3, rel=0.1)
    text = parameter_file(found, GIVEN, bag=Path("bag"), keep="mass")
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert parameters["rate_gain"] == pytest.approx([0.9, 1.0, 0.8], abs=0.01)


def test_keeps_configured_yaw_lag_without_yaw_excitation() -> None:
    given = dataclasses.replace(GIVEN, rate_time_constant=(0.05, 0.05, 0.2))
    run = flown(**TRUTH)
    still, fixed = (
        [resent(each, w_WB_B=each.value.w_WB_B * [1.0, 1.0, 0.0]) for each in messages]
        for messages in (run.commands, run.odometries)
    )
    data = measured(changed(run, commands=still, odometries=fixed))
    found = fit(data, given=given)
    roll, pitch, yaw = found.rate_time_constant
    assert not yaw.seen
    assert (roll.value, pitch.value) == pytest.approx((0.03, 0.03), rel=0.02)
    text = parameter_file(found, given, bag=Path("bag"), keep="mass")
    (line,) = (line for line in text.splitlines() if "rate_time_constant:" in line)
    assert line.endswith("; kept, not observable")
    assert ", 0.2]" in line


def test_refuses_a_value_at_a_bound() -> None:
    """The throttle of another flight does nothing to the vehicle: no lag is long enough for it."""
    run, given = flown(**TRUTH), dataclasses.replace(GIVEN, thrust_time_constant=0.07)
    others = [
        resent(command, throttle=other.value.throttle)
        for command, other in zip(run.commands, flown(seed=1).commands, strict=True)
    ]
    found = fit(measured(changed(run, commands=others)), given=given)
    assert found.thrust_time_constant.at_bound
    text = " ".join(identification_table(found, given, command_age=float("nan")).split())
    assert "warning: thrust_time_constant was estimated as 1000.0 ms, the end of the" in text
    with pytest.raises(UserError, match="of the variation of the velocity is unexplained"):
        parameter_file(found, given, bag=Path("bag"), keep="mass")


@pytest.mark.slow
def test_confidence_intervals_have_the_stated_coverage() -> None:
    inside = {name: np.zeros(len(truth), dtype=int) for name, truth in THE_TRUTH.items()}
    for seed in range(20):
        for name, each in off(each_axis_identified(seed)).items():
            inside[name] += [error <= width for error, width in each]
    # Of 20 intervals of 95 %, fewer than 17 hold the truth less than twice in a hundred times.
    assert {name for name, count in inside.items() if count.min() < 17} == set(), inside


def test_a_long_flight_is_fitted_in_parts() -> None:
    data = measured(flown(**TRUTH, duration=60.0))
    assert data.thinned(len(data.time)) is data
    some = data.thinned(1000)
    assert 700 < len(some.time) <= 1250
    assert np.all(np.diff(some.time) > 0.0)
    assert len(some.command_time) < 0.8 * len(data.command_time)
    # Blocks from beginning to end, each ended by an odometry that is not used.
    gaps = np.flatnonzero(np.diff(some.time) > 2.0 * data.period)
    assert len(gaps) >= 3
    assert not np.any(some.usable[gaps])
    assert some.time[-1] > 0.7 * data.time[-1]
    assert_near(fit(some, given=GIVEN), relative=0.01, drag_within=0.05)


def test_a_recording_is_identified(tmp_path: Path, make_bag: Callable[..., Any]) -> None:
    run = flown(**TRUTH)
    bag = make_bag()
    for odometry in run.odometries:
        bag.odometry(odometry.value)
    for command in run.commands:
        bag.command(command.value)
    bag.writer.close()
    found = identify(Recording(bag.writer.directory))
    assert found.fitted == found.flown
    assert found.rate_time_constant == identified(run).rate_time_constant
