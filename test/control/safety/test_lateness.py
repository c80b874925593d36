"""How late an odometry is, and what knowing it is worth in a flight."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.clock_offset import Lateness
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

MS = 1_000_000
DAY = 86_400_000 * MS


@pytest.mark.parametrize("clock_ns", [0, DAY, -DAY], ids=["same clock", "behind", "ahead"])
def test_counts_from_the_fastest_whatever_the_clock(clock_ns: int) -> None:
    lateness = Lateness(most_ns=100 * MS)
    found = [
        lateness.of(20 * k * MS, now_ns=clock_ns + (20 * k + 5 + late) * MS)
        for k, late in enumerate([30, 0, 25, 60])
    ]
    # The offset is followed by 2 % of the time.
    assert found == [0, 0, pytest.approx(25 * MS, abs=3 * MS), pytest.approx(60 * MS, abs=3 * MS)]


def test_begins_anew_when_a_clock_is_set() -> None:
    lateness = Lateness(most_ns=100 * MS)
    assert lateness.of(0, now_ns=0) == 0
    assert lateness.of(20 * MS, now_ns=320 * MS) == 0
    assert lateness.of(40 * MS, now_ns=350 * MS) == pytest.approx(10 * MS, abs=MS)


class Jittered:
    """A controller whose odometries are late by the magnitude of N(0, 30 ms), in order."""

    def __init__(self, controller: Controller, *, tells: bool) -> None:
        self._controller, self._tells = controller, tells
        self._random = np.random.default_rng(1)
        self._way: deque[tuple[int, OdometrySample, ReferenceWindow]] = deque()
        self._looks, self._newest_ns = 0, 0

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Send the odometry on its way 50 times a second, and answer what arrives."""
        now_ns = odometry.stamp_ns
        if self._looks % 20 == 0:
            late_ns = round(abs(self._random.normal(0.0, 30.0))) * MS if self._looks else 0
            self._newest_ns = max(self._newest_ns, now_ns + late_ns)
            self._way.append((self._newest_ns, odometry, window))
        self._looks += 1
        arrived = None
        while self._way and self._way[0][0] <= now_ns:
            _, *arrived = self._way.popleft()
        if arrived is None:
            return None
        odometry, window = arrived
        self._controller.receive_reference(window, now_ns=now_ns)
        # Without times of arrival none is known to be late.
        told_ns = now_ns if self._tells else odometry.stamp_ns
        tick = self._controller.receive_odometry(odometry, now_ns=told_ns)
        return None if tick is None else tick.command


@pytest.mark.parametrize("tells", [True, False], ids=["known", "not known"])
def test_a_vehicle_with_delay_of_its_own_keeps_its_way_if_lateness_is_known(tells: bool) -> None:
    """A delay of 90 ms of which 20 are modelled, and 22 ms of lateness in the mean on top."""
    simulator = SimulatorConfig(command_delay=0.09, odom_rate=1000.0, duration=12.0)
    mpc, reference = MpcConfig(lockstep=False), ReferenceConfig(trajectory="lemniscate")
    controller = Jittered(Controller(mpc), tells=tells)
    errors = [
        float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0]))
        for step in fly(simulator=simulator, reference=reference, controller=controller)
    ]
    settled = float(np.mean(errors[len(errors) // 3 :]))
    if tells:
        assert settled < 0.03
    else:
        assert settled > 0.3  # lost: what is asked of the known one is no matter of course
