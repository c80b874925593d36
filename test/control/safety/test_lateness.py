# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lateness of an odometry by true stamps and by stamps of arrival, and its compensation."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any, NamedTuple

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.estimation.arrival_stamps import ArrivalStamps
from quad_mpc_ros.control.estimation.clock_offset import Lateness
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

MS = 1_000_000
DAY = 86_400_000 * MS


@pytest.mark.parametrize("clock_ns", [0, DAY, -DAY], ids=["same clock", "behind", "ahead"])
def test_lateness_is_relative_to_the_fastest_with_any_clock(clock_ns: int) -> None:
    lateness = Lateness(MpcConfig(odom_timeout=0.1))
    found = []
    for k, late in enumerate([30, 0, 25, 60]):
        stamp_ns, now_ns = 20 * k * MS, clock_ns + (20 * k + 5 + late) * MS
        lateness.arrive(stamp_ns, now_ns=now_ns)
        found.append(lateness.sent_ns(now_ns) - stamp_ns)
    # The offset is followed by 2 % of the time.
    assert found == [0, 0, pytest.approx(25 * MS, abs=3 * MS), pytest.approx(60 * MS, abs=3 * MS)]
    assert lateness.sent_ns(clock_ns + 200 * MS) == pytest.approx(195 * MS, abs=3 * MS)


def test_lateness_restarts_when_a_clock_is_set() -> None:
    lateness = Lateness(MpcConfig(odom_timeout=0.1))
    for stamp_ns, now_ns, expected in ((0, 0, 0), (20, 320, 20), (40, 350, 50)):
        lateness.arrive(stamp_ns * MS, now_ns=now_ns * MS)
        assert lateness.sent_ns(now_ns * MS) == pytest.approx(expected * MS, abs=MS)


class Jittered:
    """A controller whose odometries are late by the magnitude of N(0, 30 ms), in order."""

    def __init__(self, controller: Controller, *, stamps: str) -> None:
        self._controller, self._stamps = controller, stamps
        self._random = np.random.default_rng(1)
        self._queue: deque[tuple[int, OdometrySample, ReferenceWindow]] = deque()
        self._calls, self._newest_ns = 0, 0

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Delay an odometry 50 times a second, and answer those that arrive."""
        now_ns, window_now = odometry.stamp_ns, window
        if self._calls % 20 == 0:
            late_ns = round(abs(self._random.normal(0.0, 30.0))) * MS if self._calls else 0
            self._newest_ns = max(self._newest_ns, now_ns + late_ns)
            self._queue.append((self._newest_ns, odometry, window))
        self._calls += 1
        arrived = None
        while self._queue and self._queue[0][0] <= now_ns:
            _, *arrived = self._queue.popleft()
        if arrived is None:
            return None
        odometry, window = arrived
        if self._stamps == "arrived":
            odometry = dataclasses.replace(odometry, stamp_ns=now_ns)
            window = dataclasses.replace(window_now, stamp_ns=now_ns)
        self._controller.receive_reference(window, now_ns=now_ns)
        tick = self._controller.receive_odometry(odometry, now_ns=now_ns)
        return None if tick is None else tick.command


@pytest.mark.parametrize("stamps", ["measured", "arrived"])
def test_tracks_with_late_odometry_and_an_unmodelled_delay(stamps: str) -> None:
    """A delay of 70 ms, of which 20 are modelled, and a mean lateness of 22 ms."""
    simulator = SimulatorConfig(command_delay=0.07, odom_rate=1000.0, duration=12.0)
    mpc, reference = MpcConfig(lockstep=False), ReferenceConfig(trajectory="lemniscate")
    controller = Jittered(Controller(mpc), stamps=stamps)
    errors = [
        float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]))
        for step in fly(simulator=simulator, reference=reference, controller=controller)
    ]
    settled = float(np.mean(errors[len(errors) // 3 :]))
    assert settled < (0.03 if stamps == "measured" else 0.1)


class Track(NamedTuple):
    """Odometries of a vehicle on a circle, and their times of measurement and arrival [s]."""

    measured: Array
    arrived: Array
    odometries: list[OdometrySample]


def track(
    seed: int,
    *,
    jitter: float = 0.0,
    late: float = 0.0,
    lost: float = 0.0,
    speed: float = 3.0,
    noise: tuple[float, float, float] = (0.003, 0.003, 0.003),
) -> Track:
    """Measure 50 times a second for 12 s; ``jitter`` [s] is that of the times of measurement."""
    random = np.random.default_rng(seed)
    measured = np.arange(0.0, 12.0, 0.02)
    measured = measured + jitter * random.uniform(0.0, 0.9, len(measured))
    measured = measured[random.random(len(measured)) >= lost]
    arrived = np.maximum.accumulate(
        measured + late * np.abs(random.standard_normal(len(measured)))
    )
    last = np.append(np.diff(arrived) > 1e-6, True)  # the newest of those that arrive together
    measured, arrived = measured[last], arrived[last]
    odometries = []
    for seconds in measured:
        phase = 0.5 * speed * seconds
        v_WB_W = speed * np.array([-np.sin(phase), np.cos(phase), 0.0])
        odometries.append(
            OdometrySample(
                stamp_ns=round(1e9 * seconds),
                p_WB=2.0 * np.array([np.cos(phase), np.sin(phase), 1.0])
                + random.normal(size=3) * noise,
                q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
                v_WB_B=v_WB_W + random.normal(scale=0.02, size=3),
                w_WB_B=np.zeros(3),
            )
        )
    return Track(measured, arrived, odometries)


@pytest.mark.parametrize(
    "source",
    [
        {},
        {"noise": (0.1, 0.1, 0.1)},
        {"jitter": 0.02, "lost": 0.05},
        {"jitter": 0.02, "noise": (0.1, 0.1, 0.1), "lost": 0.05},
        {"late": 0.03, "lost": 0.05},
        {"late": 0.03, "jitter": 0.02, "noise": (0.003, 0.003, 0.1)},
    ],
    ids=["regular", "noisy", "irregular", "irregular, noisy", "late", "late, irregular"],
)
@pytest.mark.parametrize("seed", range(2))
def test_true_stamps_are_not_changed(source: dict[str, Any], seed: int) -> None:
    stamps, flown = ArrivalStamps(), track(seed, **source)
    for odometry, arrived in zip(flown.odometries, flown.arrived, strict=True):
        assert stamps.corrected(odometry, now_ns=round(1e9 * arrived)) is odometry


@pytest.mark.parametrize("latency_ns", [0, 300_000])
@pytest.mark.parametrize("seed", range(2))
def test_corrects_stamps_of_arrival(seed: int, latency_ns: int) -> None:
    """The mean lateness of 20 ms or more is reduced to less than 7 ms."""
    stamps, flown = ArrivalStamps(), track(seed, late=0.03, lost=0.05)
    errors, before_ns = [], -1
    for measured, arrived, odometry in zip(*flown, strict=True):
        stamped = dataclasses.replace(odometry, stamp_ns=round(1e9 * arrived))
        corrected = stamps.corrected(stamped, now_ns=stamped.stamp_ns + latency_ns)
        assert before_ns < corrected.stamp_ns <= stamped.stamp_ns
        before_ns = corrected.stamp_ns
        errors.append(1e-9 * corrected.stamp_ns - measured)
    late, left = (flown.arrived - flown.measured)[100:], np.array(errors)[100:]
    assert np.std(left) < 0.6 * np.std(late)
    assert abs(np.mean(left)) < 0.3 * np.mean(late)


def test_keeps_stamps_in_hover() -> None:
    """Positions in hover do not show the time."""
    stamps, flown = ArrivalStamps(), track(1, late=0.03, lost=0.05, speed=0.02)
    for arrived, odometry in zip(flown.arrived, flown.odometries, strict=True):
        stamped = dataclasses.replace(odometry, stamp_ns=round(1e9 * arrived))
        assert stamps.corrected(stamped, now_ns=stamped.stamp_ns) is stamped
