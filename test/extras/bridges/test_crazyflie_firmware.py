# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the plant ``rotors`` with the Crazyflie's firmware over CRTP, by UDP and cflib.

The firmware runs in real time at most, and its rate loop in step with the plant: a busy machine
makes the flights longer, not worse.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.crazyflie_firmware import Firmware, executable
from fixtures.firmware_plant import (
    LEMNISCATE,
    MILLISECOND,
    FirmwarePlant,
    LiveFlight,
    bridged,
    configured,
    errors,
    flown,
)
from fixtures.stack_messages import new_message

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.extras.bridges.crazyflie import CrazyflieBridge
from quad_mpc_ros.extras.bridges.crazyflie.line import CrazyflieLine
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig
from quad_mpc_ros.ros.bridges.bridge import OutgoingMessage
from quad_mpc_ros.simulation.config import SimulatorConfig

VEHICLE = "vehicles/crazyflie"
CALIBRATION = 2.5  # s
PATIENCE = 60.0  # s of this machine


@pytest.fixture(scope="module", autouse=True)
def _needs() -> None:
    pytest.importorskip("cflib")
    executable()


class Bridged(FirmwarePlant):
    """The plant under the firmware's loops and mixer, with cflib in between."""

    def __init__(self, config: SimulatorConfig, **parameters: Any) -> None:
        folder = tempfile.mkdtemp(prefix="quad_mpc_ros_crazyflie_")
        self.firmware = Firmware(Path(folder, "firmware.log"))
        given = {
            "uri": self.firmware.uri,
            "mass": config.mass,
            "thrust_curve": config.thrust_curve,
            **parameters,
        }
        bridge = CrazyflieBridge(CrazyflieBridge.Config.build(given), new_message)
        assert isinstance(bridge.line, CrazyflieLine)
        self.line = bridge.line
        self.written = 0
        super().__init__(config, bridge)
        self.live(CALIBRATION)
        until = time.monotonic() + PATIENCE  # on a busy machine the answers take their time
        while (fault := bridge._stack(self.now_ns).fault) and time.monotonic() < until:
            self.live(0.1)
        assert not fault

    def close(self) -> None:
        self.line.close()
        self.firmware.close()

    def advance_to(self, time_ns: int) -> None:
        with self.firmware.awake():
            super().advance_to(time_ns)

    @property
    def info(self) -> int:
        """The last report of the supervisor."""
        return self.bridge._session.telemetry.info  # type: ignore[attr-defined, no-any-return]

    def _send_odometry(self, truth: OdometrySample) -> None:
        message = new_message("nav_msgs/msg/Odometry")
        conversions.fill_odometry(message, truth)
        self.bridge.subscriptions[0].receive(message, self.now_ns)

    def _send(self, outgoing: OutgoingMessage | bytes) -> None:
        assert isinstance(outgoing, bytes)
        self._write(outgoing)

    def _write(self, data: bytes) -> None:
        self.line.write(data)
        while data:
            self.written += 1
            data = data[1 + data[0] :]
        until = time.monotonic() + 5.0
        while self.firmware.from_bridge < self.written:  # a thread sends it
            assert time.monotonic() < until
            self.firmware.pass_on()

    def _levels(self, force_B: Array, w_WB_B: Array) -> Any:
        if self.passed_ns % (5 * MILLISECOND) == 0:
            self._write(self.bridge.exchange(self.line.read(), now_ns=self.now_ns))
        self.firmware.step(force_B, w_WB_B)
        return [power / crtp.PWM_FULL for power in self.firmware.motors]

    def take_over(self, throttle: float) -> None:
        self.live(0.1, 0.0)  # the firmware has not flown yet, so the vehicle counts as landed
        answer = self.bridge.engage(True, now_ns=self.now_ns)
        assert answer.accepted, answer.text
        self.live(0.5, throttle)
        assert self.bridge.handover[0] == "engaged"
        self.is_held = False


def vehicle(*assignments: str, **mpc: Any) -> FlightConfig:
    return configured(VEHICLE, *assignments, **mpc)


HOVER = vehicle().simulator.initial_throttle


def test_signs_of_all_axes() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        for w in np.vstack((np.eye(3), -np.eye(3))):
            plant.live(0.6, HOVER, w)
            found = plant.odometry(0).w_WB_B
            np.testing.assert_allclose(found[:2], w[:2], atol=0.1)
            assert found[2] == pytest.approx(w[2], abs=0.45)  # slow, and its integrator remembers


def test_silence_of_the_bridge_levels_then_locks_the_vehicle() -> None:
    """The firmware's clock may run ahead of the plant's, so only the order is tested."""
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.live(0.3, HOVER, (1.0, 0.0, 0.0))
        plant.firmware.is_cut = True
        plant.live(0.1)
        assert plant.odometry(0).w_WB_B[0] > 0.8  # the last rates
        seen = []
        for _ in range(60):
            plant.live(0.05)
            seen.append((plant.odometry(0).up > 0.99, max(plant.firmware.motors) > 0))
        level = seen.index((True, True))
        stopped = next(place for place, (_, runs) in enumerate(seen) if not runs)
        assert level < stopped
        plant.firmware.is_cut = False
        plant.live(1.5)
        assert plant.info & crtp.IS_LOCKED
        refused = plant.bridge.engage(True, now_ns=plant.now_ns)
        assert not refused.accepted and "restart it" in refused.text


def test_commands_that_stop_make_the_firmware_land() -> None:
    with bridged(Bridged, vehicle(), 0.0) as plant:
        plant.is_held = False
        flight = risen(plant, vehicle("reference.takeoff_height=1.0"))
        flight.is_commanding = False
        flight.fly(9.0)
        assert any("requesting landing" in each for each in plant.warnings)
        assert plant.bridge.handover[0] == "released"
        assert max(plant.firmware.motors) == 0 and flight.heights[-1] < 0.1
        assert not plant.info & crtp.IS_LOCKED


def test_release_requests_position_hold_of_the_firmware() -> None:
    with bridged(Bridged, vehicle(), 0.0) as plant:
        plant.is_held = False
        flight = risen(plant, vehicle("reference.takeoff_height=1.0"))
        released = plant.bridge.engage(False, now_ns=plant.now_ns)
        plant.send(released.messages)
        flight.fly(6.0)
        assert flight.heights[-1] == pytest.approx(1.0, abs=0.15)
        assert not plant.info & crtp.IS_LOCKED


def test_disarming_in_flight_stops_the_motors() -> None:
    with bridged(Bridged, vehicle()) as plant:
        plant.take_over(HOVER)
        plant.live(1.0, HOVER)
        disarmed = plant.bridge.arm(False, now_ns=plant.now_ns)
        plant.send(disarmed.messages)
        plant.live(0.1, HOVER)
        assert max(plant.firmware.motors) == 0
        assert not plant.bridge.engaged(now_ns=plant.now_ns)


def risen(plant: Bridged, loaded: FlightConfig) -> LiveFlight:
    """Return a flight that has taken off."""
    flight = LiveFlight(loaded, plant)
    flight.fly(0.5)
    answer = plant.bridge.engage(True, now_ns=plant.now_ns)
    assert answer.accepted, answer.text
    flight.fly(0.5)
    assert plant.bridge.handover[0] == "engaged"
    assert max(flight.heights) < 0.1
    assert flight.live.take_off(plant.now_ns).accepted
    flight.fly(5.0)
    return flight


def test_take_off_lemniscate_landing_and_disarming() -> None:
    loaded = vehicle(
        "reference.trajectory=lemniscate",
        "reference.angular_frequency=1.0",
        "reference.takeoff_height=1.5",
    )
    with bridged(Bridged, vehicle(), 0.0) as plant:
        plant.is_held = False
        flight = risen(plant, loaded)
        assert flight.heights[-1] == pytest.approx(1.5, abs=0.05)
        assert flight.live.start(plant.now_ns).accepted
        flight.fly(12.0)
        assert flight.error < 0.05
        assert flight.live.land(plant.now_ns).accepted
        flight.fly(10.0)
        assert flight.heights[-1] < 0.1
        plant.send(plant.bridge.arm(False, now_ns=plant.now_ns).messages)
        flight.fly(3.0)
        assert max(plant.firmware.motors) == 0
        assert not plant.info & (crtp.IS_FLYING | crtp.IS_LOCKED)


SLOW, QUICK = (
    (*LEMNISCATE, f"reference.angular_frequency={frequency}") for frequency in (1.0, 1.5)
)
# What ``identify`` finds of the slow one.
FOUND: dict[str, Any] = {
    "rate_time_constant": (0.0, 0.0, 0.532),
    "rate_gain": (1.015, 1.006, 1.063),
    "thrust_time_constant": 0.038,
    "input_delay": 0.040,
    "drag": (0.006, 0.012, 0.218),
    "rotor_drag": (0.247, 0.242, 0.0),
}


@pytest.mark.parametrize(
    ("assignments", "mpc", "most"),
    [
        (("reference.trajectory=hover",), {}, 0.02),
        (SLOW, {}, 0.05),
        (SLOW, FOUND, 0.02),
        (QUICK, FOUND, 0.03),
    ],
    ids=["hover", "lemniscate with guessed lags", "identified", "a quick one identified"],
)
def test_follows_the_reference(assignments: Any, mpc: Any, most: float) -> None:
    flight, _ = flown(vehicle(*assignments, **mpc), Bridged, duration=20.0 if not mpc else 12.0)
    assert np.sqrt(np.mean(errors(flight)[100:] ** 2)) < most
    assert flight.stats["thrust_scale"][-1] == pytest.approx(1.0, abs=0.05)
