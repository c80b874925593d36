# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly real Betaflight with the bridge over a pseudo-terminal.

The bridge's bytes go through pyserial into the terminal, from there to the firmware's UART1, and
its answers back; the body and the rotors are those of the plant ``betaflight``. Time is the
simulation's, so that the flights do not depend on how busy the machine is.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import tty
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fixtures.stack_messages import new_message

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.extras.bridges.betaflight import BetaflightBridge
from quad_mpc_ros.extras.plants.betaflight import firmware as firmware_module
from quad_mpc_ros.extras.plants.betaflight.firmware import AT_REST, Sensed
from quad_mpc_ros.extras.plants.betaflight.plant import BetaflightPlant
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, load_config, simulate
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.simulation.config import SimulatorConfig

MILLISECOND = 1_000_000
SECOND = 1_000_000_000
START_NS = SECOND

# What ``identify`` finds of a flight of the lemniscate at 1.5 rad/s through the bridge.
FOUND = {"rate_time_constant": (0.0068, 0.0087, 0.0105), "thrust_time_constant": 0.0226}

ACTUAL_WITH_EXPO = ("set roll_expo = 40", "set roll_rc_rate = 20")
BETAFLIGHT_RATES = (
    "set rates_type = BETAFLIGHT",
    *(f"set {axis}_rc_rate = 120" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_srate = 65" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_expo = 20" for axis in ("roll", "pitch", "yaw")),
)
QUICK_RATES = (
    "set rates_type = QUICK",
    *(f"set {axis}_rc_rate = 90" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_srate = 70" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_expo = 30" for axis in ("roll", "pitch", "yaw")),
)


@pytest.fixture(autouse=True)
def firmware() -> None:
    """Skip where the firmware, or pyserial, is missing."""
    pytest.importorskip("serial")
    try:
        firmware_module.firmware_path()
        firmware_module.shim_path()
    except UserError as error:
        pytest.skip(str(error))


DROPPED_AFTER = 1.0  # s; a serial line drops what is not taken within 10 ms, as on a busy machine


class Bridged(BetaflightPlant):
    """The plant whose sticks come from a bridge, over a pseudo-terminal."""

    def __init__(
        self, config: SimulatorConfig, *, is_armed: bool = True, **parameters: Any
    ) -> None:
        """Begin armed by a pilot, or leave arming to the bridge."""
        self.controller, device = os.openpty()
        tty.setraw(device, termios.TCSANOW)
        os.set_blocking(self.controller, False)
        name = os.ttyname(device)
        curve = (config.rotors.thrust_coefficient * config.rotors.speed_max**2, 0.0, 0.0)
        given = {
            "device": name,
            "receiver": "bridge",
            "min_check": 1010,
            "mass": config.mass,
            "thrust_curve": config.thrust_curve,
            "thrust_map.kind": "quadratic",
            "thrust_map.motor_curve": curve,
            **parameters,
        }
        self.bridge = BetaflightBridge(BetaflightBridge.Config.build(given), new_message)
        assert self.bridge.line is not None
        self.line = self.bridge.line
        self.is_bridged, self.is_armed = False, is_armed
        self.warnings: list[str] = []
        self.before_ns = self.underway = 0
        self.pilot: tuple[int, ...] = ()
        self.is_cut = False
        self.pulses: tuple[float, ...] = ()
        super().__init__(config)
        self.is_bridged = True
        if is_armed:  # in the air, where the bridge itself would refuse to
            self.bridge._arming_ns = self.now_ns
        os.close(device)

    def close(self) -> None:
        self.line.close()
        os.close(self.controller)

    @property
    def now_ns(self) -> int:
        return START_NS + self.before_ns + self.time_ns

    def apply(self, command: CommandSample) -> None:
        command = CommandSample(
            stamp_ns=self.now_ns, throttle=command.throttle, w_WB_B=command.w_WB_B
        )
        for sent in self.bridge.receive_command(command, now_ns=self.now_ns):
            assert isinstance(sent, bytes)
            self._write(sent)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        seen = super().odometry(stamp_ns)
        if self.is_bridged:
            message = new_message("nav_msgs/msg/Odometry")
            stamped = super().odometry(self.now_ns)
            conversions.fill_odometry(message, stamped)
            self.bridge.subscriptions[0].receive(message, self.now_ns)
        return seen

    def _arm(self) -> None:
        if self.is_armed:
            super()._arm()

    def _step(self, channels: tuple[int, ...], sensed: Sensed = AT_REST) -> tuple[float, ...]:
        if not self.is_bridged:
            return super()._step(channels, sensed)
        if self.now_ns % (5 * MILLISECOND) == 0:
            self._write(self.bridge.exchange(self.line.read(), now_ns=self.now_ns))
            self.warnings += self.bridge.take_warnings()
        while self.underway > 0:  # a terminal takes time of this machine's
            if not select.select([self.controller], [], [], DROPPED_AFTER)[0]:
                self.underway = 0
                break
            data = os.read(self.controller, 4096)
            self.underway -= len(data)
            self._firmware.send(data)
        self.pulses = self._firmware.step(MILLISECOND, sensed=sensed, channels=self.pilot)
        if answers := self._firmware.received():
            os.write(self.controller, answers)
        return self.pulses

    def _write(self, data: bytes) -> None:
        if not self.is_cut:
            self.line.write(data)
            self.underway += len(data)

    def live(self, seconds: float, throttle: float | None = None, w: Any = (0, 0, 0)) -> None:
        """Let time pass, with odometry and, if so, commands 50 times a second."""
        for _ in range(round(50 * seconds)):
            self.odometry(0)
            if throttle is not None:
                self.apply(CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(w)))
            self.advance_to(self.time_ns + 20 * MILLISECOND)

    def take_over(self, throttle: float) -> None:
        """Hold the vehicle where it is until telemetry has come, and engage."""
        held = self._body.copy()
        for _ in range(15):
            self.live(0.02, throttle)
            self._body[()] = held
        self.engage()

    def begin(self) -> None:
        """Let the plant's time begin, while the bridge's goes on."""
        self.before_ns += self.time_ns
        self.time_ns = 0

    def engage(self) -> None:
        answer = self.bridge.engage(True, now_ns=self.now_ns)
        assert answer.accepted, answer.text


def config(*settings: str, **changes: Any) -> FlightConfig:
    loaded = load_config("default", "betaflight")
    start = {
        "initial_position": (0.0, 0.0, 50.0),
        "initial_throttle": loaded.simulator.vehicle().hover_throttle,
        "betaflight.settings": ("feature AIRMODE", *settings),
        **changes,
    }
    return loaded._replace(simulator=loaded.simulator.updated(start))


@contextlib.contextmanager
def bridged(
    *settings: str, changes: Any = None, is_armed: bool = True, **parameters: Any
) -> Iterator[Bridged]:
    plant = Bridged(
        config(*settings, **(changes or {})).simulator, is_armed=is_armed, **parameters
    )
    try:
        yield plant
    finally:
        plant.close()


HOVER = config().simulator.vehicle().hover_throttle


@pytest.mark.parametrize(
    "settings", [(), ACTUAL_WITH_EXPO, BETAFLIGHT_RATES, QUICK_RATES], ids=str
)
def test_every_kind_of_rates_is_inverted_with_the_signs_of_all_axes(
    settings: tuple[str, ...],
) -> None:
    with bridged(*settings) as plant:
        plant.take_over(HOVER)
        for w in np.vstack((np.eye(3), -np.eye(3))) * (1.5, 1.5, 1.0):
            plant.live(0.4, HOVER, w)
            np.testing.assert_allclose(plant.odometry(0).w_WB_B, w, atol=0.08)


def test_arms_on_the_ground_and_disarms_after_lost_commands() -> None:
    ground = {"initial_position": (0.0, 0.0, 0.0), "initial_throttle": 0.0}
    with bridged(changes=ground, is_armed=False) as plant:
        plant.live(1.0, 0.0)
        assert max(plant.pulses) == 1000.0
        plant.engage()
        plant.live(0.3, 0.0)
        armed = plant.bridge.arm(True, now_ns=plant.now_ns)
        assert armed.accepted, armed.text
        plant.live(0.5, 0.0)
        assert min(plant.pulses) > 1040.0 and plant.bridge.handover[0] == "engaged"
        plant.live(0.8, 1.5 * HOVER)
        plant.live(0.2, HOVER, (1.5, 0.0, 0.0))
        height, leaning = plant.state.p_WB[2], plant.odometry(0).up
        assert height > 0.3 and leaning < 0.97
        plant.live(1.0)
        assert plant.odometry(0).up > 0.995  # level by the attitude of the firmware
        assert min(plant.pulses) > 1040.0
        plant.live(3.5)
        assert max(plant.pulses) == 1000.0  # disarmed
        assert plant.bridge.handover[0] == "released"
        plant.live(1.0, HOVER)
        assert max(plant.pulses) == 1000.0


OVERRIDE = ("set msp_override_channels_mask = 15", "aux 1 50 1 1700 2100 0 0")


def pilot(*, arm: bool, override: bool, throttle: int = 1000) -> tuple[int, ...]:
    """Return the channels of a transmitter: sticks centred, switches for the two modes."""
    switches = (2000 if arm else 1000, 2000 if override else 1000)
    return (1500, 1500, throttle, 1500, *switches, *(10 * (1000,)))


def test_pilot_arms_hands_over_and_takes_back() -> None:
    ground = {"initial_position": (0.0, 0.0, 0.0), "initial_throttle": 0.0}
    with bridged(*OVERRIDE, changes=ground, is_armed=False, receiver="pilot") as plant:
        plant.pilot = pilot(arm=False, override=False)
        plant.live(1.0, 0.0)
        plant.engage()
        plant.live(0.2, 0.0)
        assert plant.bridge.handover[0] == "offered"
        plant.pilot = pilot(arm=True, override=False)
        plant.live(0.5, 0.0)
        assert min(plant.pulses) > 1040.0  # idling
        plant.pilot = pilot(arm=True, override=True)
        plant.live(0.2, 0.0)
        assert plant.bridge.handover[0] == "engaged"
        plant.live(1.0, 1.4 * HOVER)
        plant.live(0.3, HOVER, (0.0, 1.0, 0.0))
        assert plant.state.p_WB[2] > 0.3
        assert plant.odometry(0).w_WB_B[1] == pytest.approx(1.0, abs=0.1)
        plant.pilot = pilot(arm=True, override=False, throttle=1700)
        plant.live(0.5, HOVER, (0.0, 1.0, 0.0))
        assert plant.bridge.handover[0] == "released"
        assert abs(plant.odometry(0).w_WB_B[1]) < 0.1  # the pilot's sticks are centred
        plant.pilot = pilot(arm=True, override=True)
        plant.live(0.5, 1.5 * HOVER, (0.0, 1.0, 0.0))
        assert abs(plant.odometry(0).w_WB_B[1]) < 0.1 and plant.bridge.handover[0] == "released"


def test_replaces_the_last_sticks_when_commands_stop() -> None:
    """Which it would: with the line cut it goes on turning."""
    ground = {"initial_position": (0.0, 0.0, 0.0), "initial_throttle": 0.0}
    for is_cut in (True, False):
        with bridged(*OVERRIDE, changes=ground, is_armed=False, receiver="pilot") as plant:
            plant.pilot = pilot(arm=False, override=False)
            plant.live(1.0, 0.0)
            plant.engage()
            plant.pilot = pilot(arm=True, override=False)
            plant.live(0.5, 0.0)
            plant.pilot = pilot(arm=True, override=True)
            plant.live(0.2, 0.0)
            plant.live(1.0, 1.4 * HOVER)
            plant.live(0.4, 1.1 * HOVER, (0.0, 0.0, 1.0))
            assert plant.bridge.handover[0] == "engaged"
            plant.is_cut = is_cut
            plant.live(0.8)
            assert plant.state.p_WB[2] > 0.5
            turning = plant.odometry(0).w_WB_B[2]
            assert turning == pytest.approx(1.0 if is_cut else 0.0, abs=0.1)


@pytest.mark.parametrize(
    ("frequency", "most"), [(0.0, 0.002), (1.0, 0.002), (1.5, 0.003), (2.0, 0.005)]
)
def test_tracks_as_well_as_without_a_bridge(frequency: float, most: float) -> None:
    """Hover and lemniscates, the lags as identified; the square is flown with those of default."""
    kind = ["lemniscate", f"reference.angular_frequency={frequency}"] if frequency else ["hover"]
    loaded = load_config(
        "default", "betaflight", assignments=[f"reference.trajectory={kind[0]}", *kind[1:]]
    )
    mpc = loaded.mpc.updated({**FOUND, "input_delay": 0.007})
    error = flown(loaded._replace(mpc=mpc), duration=12.0)[250:]
    assert np.sqrt(np.mean(error**2)) < most


def flown(loaded: FlightConfig, *, duration: float) -> Any:
    """Return the errors of a flight that begins at rest where the reference begins."""
    first = configured_trajectory(loaded.reference).at([0]).p_WB[0]
    throttle = loaded.simulator.vehicle().hover_throttle
    simulator = loaded.simulator.updated(
        {"initial_position": tuple(map(float, first)), "initial_throttle": throttle}
    )
    plant = Bridged(simulator)
    try:
        plant.take_over(throttle)
        plant.begin()
        flight = simulate(loaded.mpc, simulator, loaded.reference, plant=plant, duration=duration)
    finally:
        plant.close()
    return np.linalg.norm(flight.p_WB - flight.reference.p_WB, axis=1)
