"""The bridge and the Crazyflie's firmware: CRTP over UDP by cflib, flown with our rotors and body.

The firmware runs in real time at most, and its rate loop in step with the plant: a busy machine
makes the flights longer, not worse.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.crazyflie_firmware import Firmware, executable
from fixtures.stack_messages import new_message

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, load_config, simulate
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.ros.bridges.bridge import OutgoingBytes
from quad_mpc_ros.ros.bridges.crazyflie import CrazyflieBridge
from quad_mpc_ros.ros.bridges.crazyflie.line import CrazyflieLine
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.rotors import motion
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

MILLISECOND = 1_000_000
SECOND = 1_000_000_000
START_NS = SECOND
CALIBRATION = 2.5  # s


@pytest.fixture(scope="module", autouse=True)
def _needs() -> None:
    pytest.importorskip("cflib")
    executable()


class Bridged(RotorsPlant):
    """The rotors and the body of the plant ``rotors`` under the firmware's loops and mixer."""

    def __init__(self, config: SimulatorConfig, **parameters: Any) -> None:
        self.before_ns = 0
        self.is_held = True
        self.warnings: list[str] = []
        folder = tempfile.mkdtemp(prefix="quad_mpc_ros_crazyflie_")
        self.firmware = Firmware(Path(folder, "firmware.log"))
        given = {
            "uri": self.firmware.uri,
            "mass": config.mass,
            "thrust_curve": config.thrust_curve,
            **parameters,
        }
        self.bridge = CrazyflieBridge(CrazyflieBridge.Config.build(given), new_message)
        assert self.bridge.line is not None
        self.line = CrazyflieLine(self.bridge.line)
        self.written = 0
        self._until_loop_ns = 0
        # Front right, back right, back left, front left.
        corners = [(1, -1), (-1, -1), (-1, 1), (1, 1)]
        self._motor_of_rotor = [
            corners.index((round(np.sign(x)), round(np.sign(y))))
            for x, y in zip(config.rotors.x, config.rotors.y, strict=True)
        ]
        super().__init__(config)
        self._v_before = self._body["v_WC_W"].copy()
        self.live(CALIBRATION)

    def close(self) -> None:
        self.line.close()
        self.firmware.close()

    @property
    def now_ns(self) -> int:
        return START_NS + self.before_ns + self.time_ns

    def apply(self, command: CommandSample) -> None:
        command = CommandSample(
            stamp_ns=self.now_ns, throttle=command.throttle, w_WB_B=command.w_WB_B
        )
        for sent in self.bridge.receive_command(command, now_ns=self.now_ns):
            assert isinstance(sent, OutgoingBytes)
            self._write(sent.data)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        seen = super().odometry(stamp_ns)
        message = new_message("nav_msgs/msg/Odometry")
        conversions.fill_odometry(message, super().odometry(self.now_ns))
        self.bridge.subscriptions[0].receive(message, self.now_ns)
        return seen

    def _write(self, data: bytes) -> None:
        self.line.write(data)
        while data:
            self.written += 1
            data = data[1 + data[0] :]
        until = time.monotonic() + 5.0
        while self.firmware.from_bridge < self.written:  # a thread sends it
            assert time.monotonic() < until
            self.firmware.pass_on()

    def _move(self, *, duration_ns: int) -> None:
        while duration_ns > 0:
            if self._until_loop_ns == 0:
                self._fly()
                self._until_loop_ns = MILLISECOND
            until_ns = min(duration_ns, self._until_loop_ns)
            held = self._body.copy()
            motion.coast(
                self._body,
                speeds=self._speeds,
                wanted=self._wanted,
                inputs=self._inputs,
                craft=self._craft,
                rotors=self._rotors,
                duration_ns=until_ns,
            )
            if self.is_held:
                self._body[()] = held
            self._until_loop_ns -= until_ns
            self.passed_ns += until_ns
            duration_ns -= until_ns

    passed_ns = 0

    def _fly(self) -> None:
        if self.passed_ns % (5 * MILLISECOND) == 0:
            self._write(self.bridge.exchange(self.line.read(), now_ns=self.now_ns))
            self.warnings += self.bridge.take_warnings()
        v_W = self._body["v_WC_W"].copy()
        a_W = (v_W - self._v_before) * 1e3
        self._v_before = v_W
        R_WB = so3.rotation_from_quaternion_xyzw(self._body["q_WB_xyzw"].copy())
        force = R_WB.T @ (a_W + np.array([0.0, 0.0, self._config.gravity]))
        self.firmware.step(force, self._body["w_WB_B"])
        a, b, c = self._config.thrust_curve
        for rotor, motor in enumerate(self._motor_of_rotor):
            power = self.firmware.motors[motor] / 65535.0
            thrust = max((a * power + b) * power + c, 0.0)
            self._wanted[rotor] = np.sqrt(thrust / self._config.rotors.thrust_coefficient)

    def live(self, seconds: float, throttle: float | None = None, w: Any = (0, 0, 0)) -> None:
        """Let time pass, with odometry and, if so, commands 50 times a second."""
        for _ in range(round(50 * seconds)):
            self.odometry(0)
            if throttle is not None:
                self.apply(CommandSample(stamp_ns=0, throttle=throttle, w_WB_B=np.array(w)))
            self.advance_to(self.time_ns + 20 * MILLISECOND)

    def take_over(self, throttle: float) -> None:
        """Engage the bridge while the vehicle is held where it is, then let it go."""
        self.live(0.1, 0.0)  # the firmware has not flown yet, so the vehicle counts as landed
        answer = self.bridge.engage(True, now_ns=self.now_ns)
        assert answer.accepted, answer.text
        self.live(0.5, throttle)
        assert self.bridge.handover[0] == "engaged"
        self.is_held = False

    def begin(self) -> None:
        """Let the plant's time begin, while the bridge's goes on."""
        self.before_ns += self.time_ns
        self.time_ns = 0


def vehicle(**changes: Any) -> FlightConfig:
    """Return the default configuration with mass and thrust of a Crazyflie."""
    loaded = load_config("default", "vehicles/crazyflie")
    start = {"initial_throttle": loaded.simulator.vehicle().hover_throttle, **changes}
    return loaded._replace(simulator=loaded.simulator.updated(start))


@contextlib.contextmanager
def bridged(changes: Any = None, **parameters: Any) -> Iterator[Bridged]:
    plant = Bridged(vehicle(**(changes or {})).simulator, **parameters)
    try:
        yield plant
    finally:
        plant.close()


AIR = {"initial_position": (0.0, 0.0, 50.0)}
HOVER = vehicle().simulator.vehicle().hover_throttle


def test_signs_of_all_axes() -> None:
    with bridged(AIR) as plant:
        plant.take_over(HOVER)
        for w in np.vstack((np.eye(3), -np.eye(3))):
            plant.live(0.4, HOVER, w)
            np.testing.assert_allclose(plant.odometry(0).w_WB_B, w, atol=0.45)


def flown(loaded: FlightConfig, *, duration: float) -> Any:
    """Return a flight that begins at rest where the reference begins, and its plant, closed."""
    first = configured_trajectory(loaded.reference).at([0]).p_WB[0]
    simulator = loaded.simulator.updated({"initial_position": tuple(map(float, first))})
    plant = Bridged(simulator)
    try:
        plant.take_over(HOVER)
        plant.begin()
        flight = simulate(loaded.mpc, simulator, loaded.reference, plant=plant, duration=duration)
    finally:
        plant.close()
    return flight, plant
