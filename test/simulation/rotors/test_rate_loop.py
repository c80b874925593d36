# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One turn of the rate loop, seen through the torque that the wanted speeds make."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.rotors import configured
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.rotors import rate_loop
from quad_mpc_ros.simulation.rotors.mixer import allocation, mixing

INERTIA = np.array([8.2e-4, 6.9e-4, 1.41e-3])
THROTTLE = 0.4


class Loop(NamedTuple):
    """A rate loop that has been at rest, with P alone unless configured otherwise."""

    config: SimulatorConfig
    memory: RecordArray[rate_loop.Memory]
    loop: RecordArray[rate_loop.Loop]
    mix: Array

    @classmethod
    def of(cls, **changes: Any) -> Loop:
        none = (0.0, 0.0, 0.0)
        given = {"p": (10.0, 10.0, 1.0), "i": none, "d": none, "torque_max": (9.0, 9.0, 9.0)}
        given.update(changes)
        config = configured(**{f"rate_loop__{name}": value for name, value in given.items()})
        loop = rate_loop.loop_of(config)
        return cls(config, rate_loop.begun(np.zeros(3), loop), loop, mixing(config.rotors))

    def alpha(
        self,
        rates: Any,
        *,
        gyro: Any = (0.0, 0.0, 0.0),
        on_ground: bool = False,
        throttle: float = THROTTLE,
    ) -> Array:
        """Return the angular acceleration that the wanted speeds make (3,)."""
        return (
            self.thrust_and_torque(rates, gyro=gyro, on_ground=on_ground, throttle=throttle)[1:]
            / INERTIA
        )

    def thrust_and_torque(self, rates: Any, *, gyro: Any, on_ground: bool, throttle: Any) -> Array:
        wanted = np.empty(len(self.config.rotors.x))
        rate_loop.run(
            self.memory,
            w_WB_B=np.array(gyro),
            throttle=throttle,
            rates=np.array(rates),
            on_ground=on_ground,
            loop=self.loop,
            mix=self.mix,
            out=wanted,
        )
        rotors = self.config.rotors
        return np.asarray(allocation(rotors) @ (rotors.thrust_coefficient * wanted**2))


def test_p_term_acts_on_the_error() -> None:
    assert_allclose(Loop.of().alpha([1.0, -2.0, 0.3], gyro=[0.5, 0.0, 0.1]), [5.0, -20.0, 0.2])


def test_d_term_acts_on_the_gyro_and_not_on_the_command() -> None:
    """A jump of the command makes what P makes; one of the gyro is resisted."""
    loop = Loop.of(d=(0.5, 0.5, 0.0), d_cutoff=0.0)
    assert_allclose(loop.alpha([1.0, 0.0, 0.0]), [10.0, 0.0, 0.0], atol=1e-9)
    assert_allclose(
        loop.alpha([1.0, 0.0, 0.0], gyro=[0.02, 0.0, 0.0]), [9.8 - 0.5 * 20.0, 0.0, 0.0], atol=1e-9
    )


def test_the_integral_grows_with_time_up_to_its_limit() -> None:
    loop = Loop.of(p=(0.0, 0.0, 0.0), i=(50.0, 0.0, 0.0), integral_max=(7.0, 0.0, 0.0))
    for _ in range(100):
        found = loop.alpha([1.0, 0.0, 0.0])[0]
    assert found == pytest.approx(50.0 * 0.099)  # 1 rad/s for 99 ms
    for _ in range(100):
        loop.alpha([1.0, 0.0, 0.0])
    assert loop.alpha([1.0, 0.0, 0.0])[0] == pytest.approx(7.0)


def test_integral_is_held_at_the_torque_limit() -> None:
    loop = Loop.of(p=(1e3, 0.0, 0.0), i=(50.0, 0.0, 0.0), torque_max=(0.1, 9.0, 9.0))
    for _ in range(100):
        assert loop.alpha([1.0, 0.0, 0.0])[0] == pytest.approx(0.1 / INERTIA[0])
    assert loop.alpha([1.0, 0.0, 0.0], gyro=[1.0, 0.0, 0.0])[0] == pytest.approx(0.0, abs=1e-9)


def test_no_integral_and_no_airmode_on_the_ground() -> None:
    loop = Loop.of(p=(100.0, 0.0, 0.0), i=(50.0, 0.0, 0.0))
    for _ in range(100):
        rates, gyro = [5.0, 0.0, 0.0], [0.0] * 3
        made = loop.thrust_and_torque(rates, gyro=gyro, on_ground=True, throttle=0.05)
        assert made[0] == pytest.approx(loop.config.thrust(0.05))
    assert loop.alpha([0.0, 0.0, 0.0])[0] == pytest.approx(0.0, abs=1e-9)


def test_integral_is_held_while_the_mixer_saturates() -> None:
    loop = Loop.of(p=(1e4, 0.0, 0.0), i=(50.0, 0.0, 0.0))
    for _ in range(100):
        loop.alpha([1.0, 0.0, 0.0])
    assert loop.alpha([1.0, 0.0, 0.0], gyro=[1.0, 0.0, 0.0])[0] == pytest.approx(0.0, abs=1e-9)


def test_the_filtered_gyro_lags() -> None:
    loop = Loop.of(gyro_cutoff=40.0)
    seen = [loop.alpha([0.0, 0.0, 0.0], gyro=[0.1, 0.0, 0.0])[0] / -1.0 for _ in range(60)]
    assert seen[0] < 0.1
    assert seen[-1] == pytest.approx(1.0, abs=0.01)
    assert 1.03 < max(seen) < 1.06  # a Butterworth of second order overshoots by 4.3 %
