# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of an inactive controller, and whether they suffice to activate it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.standby import Standby

MakeOdometry = Callable[..., OdometrySample]
MakeWindow = Callable[..., ReferenceWindow]

MS = 1_000_000
NOW = 1_700_000_000_000 * MS
CONFIG = MpcConfig(odom_timeout=0.1, reference_timeout=0.5)


@pytest.fixture
def standby(make_odometry: MakeOdometry, make_window: MakeWindow) -> Standby:
    """Return a standby that has just received both inputs."""
    made = Standby(CONFIG)
    made.receive_odometry(make_odometry(NOW - 20 * MS), now_ns=NOW - 20 * MS)
    made.receive_odometry(make_odometry(NOW), now_ns=NOW)
    made.receive_reference(make_window(NOW), now_ns=NOW)
    return made


def test_names_missing_input(make_odometry: MakeOdometry, make_window: MakeWindow) -> None:
    standby = Standby(CONFIG)
    standby.receive_reference(make_window(NOW), now_ns=NOW)
    assert standby.activation_blocker(CONFIG, now_ns=NOW) == "no odometry yet"
    standby = Standby(CONFIG)
    standby.receive_odometry(make_odometry(NOW), now_ns=NOW)
    assert standby.activation_blocker(CONFIG, now_ns=NOW) == "no reference yet"


def test_accepts_inputs_up_to_their_timeouts(
    standby: Standby, make_odometry: MakeOdometry
) -> None:
    assert standby.activation_blocker(CONFIG, now_ns=NOW + 100 * MS) is None
    too_old = standby.activation_blocker(CONFIG, now_ns=NOW + 101 * MS)
    assert too_old is not None
    assert too_old.startswith("odometry is 0.10 s old")
    assert "odom_timeout" in too_old

    for age_ms, fresh in ((500, True), (501, False)):
        later = NOW + age_ms * MS
        standby.receive_odometry(make_odometry(later), now_ns=later)
        obstacle = standby.activation_blocker(CONFIG, now_ns=later)
        assert (obstacle is None) == fresh
        assert fresh or (obstacle is not None and obstacle.startswith("reference is 0.50 s old"))


def test_rejects_inputs_after_clock_was_set_back(standby: Standby) -> None:
    assert standby.activation_blocker(CONFIG, now_ns=NOW - 3_600_000 * MS) is not None


def test_does_not_start_with_unusable_input(
    standby: Standby, make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    standby.receive_odometry(make_odometry(NOW, p_WB=np.full(3, np.nan)), now_ns=NOW)
    assert "not finite" in str(standby.activation_blocker(CONFIG, now_ns=NOW))
    standby.receive_odometry(make_odometry(NOW + 1), now_ns=NOW)
    standby.receive_reference(make_window(NOW, frame_id="map"), now_ns=NOW)
    assert "frame 'map'" in str(standby.activation_blocker(CONFIG, now_ns=NOW))


@pytest.mark.parametrize("stamp_ns", [0, NOW])
def test_rejects_odometry_whose_stamps_do_not_advance(
    stamp_ns: int, make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    standby = Standby(CONFIG)
    standby.receive_reference(make_window(NOW), now_ns=NOW)
    standby.receive_odometry(make_odometry(stamp_ns), now_ns=NOW)
    assert standby.activation_blocker(CONFIG, now_ns=NOW) == "no second odometry yet"
    for period in range(1, 4):
        now_ns = NOW + period * 20 * MS
        standby.receive_odometry(make_odometry(stamp_ns), now_ns=now_ns)
        blocker = standby.activation_blocker(CONFIG, now_ns=now_ns)
        assert blocker == "odometry stamps do not advance"
    standby.receive_odometry(make_odometry(NOW + 80 * MS), now_ns=NOW + 80 * MS)
    standby.receive_odometry(make_odometry(NOW + 100 * MS), now_ns=NOW + 100 * MS)
    later = NOW + 300 * MS
    standby.receive_odometry(make_odometry(later), now_ns=later)
    assert standby.activation_blocker(CONFIG, now_ns=later) is None


def test_lockstep_requires_the_reference_of_the_odometrys_stamp(
    standby: Standby, make_odometry: MakeOdometry
) -> None:
    config = dataclasses.replace(CONFIG, lockstep=True)
    assert standby.activation_blocker(config, now_ns=NOW) is None
    standby.receive_odometry(make_odometry(NOW + 20 * MS), now_ns=NOW)
    blocker = standby.activation_blocker(config, now_ns=NOW)
    assert blocker is not None and "no reference yet for the odometry of" in blocker


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_first_command_answers_the_newest_odometry(standby: Standby, lockstep: bool) -> None:
    tick = standby.begin(Controller(dataclasses.replace(CONFIG, lockstep=lockstep)))
    assert tick is not None
    assert tick.stats.source == "mpc"
    assert tick.command is not None
    assert tick.command.stamp_ns == NOW


def test_a_reset_of_the_estimate_transforms_the_inputs(
    make_odometry: MakeOdometry, make_window: MakeWindow
) -> None:
    """The first command in the new coordinates is that of a vehicle that was always there."""
    reset = EstimateReset(stamp_ns=NOW + 1, turn=0.0, step_W=np.array([40.0, -20.0, 3.0]))
    commands = []
    for moves in (False, True):
        standby, controller = Standby(CONFIG), Controller(CONFIG)
        standby.receive_odometry(make_odometry(NOW - 20 * MS), now_ns=NOW - 20 * MS)
        standby.receive_odometry(make_odometry(NOW), now_ns=NOW)
        standby.receive_reference(make_window(NOW), now_ns=NOW)
        if moves:
            standby.reset_estimate(reset)
            odometry = reset.odometry(make_odometry(NOW + 20 * MS))
            standby.receive_odometry(odometry, now_ns=NOW + 20 * MS)
        else:
            standby.receive_odometry(make_odometry(NOW + 20 * MS), now_ns=NOW + 20 * MS)
        tick = standby.begin(controller)
        assert tick is not None and tick.command is not None
        commands.append([tick.command.throttle, *tick.command.w_WB_B])
    assert commands[1] == pytest.approx(commands[0], abs=1e-6)
