"""The firmware as a process that a simulation steps.

Its packets are those that Betaflight's simulator target publishes (sitl.c, target.h): little
endian, FRD with the accelerations reversed, pulse widths in microseconds.
"""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import struct
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.plants.betaflight.installation import firmware_path, shim_path

PULSE_MIN, PULSE_MID, PULSE_MAX = 1000, 1500, 2000
_REQUEST = struct.Struct("<qIHH")
_ANSWER = struct.Struct("<q4fII")
_STATE = struct.Struct("<d3d3d4d3d3dd")
_RECEIVER = struct.Struct("<d16H")

_BOOT_TIME_NS = 1_000_000_000  # more than its start takes
_CLI_STEP_NS = 20_000_000
_RESPONSE_TIMEOUT = 20.0  # s of this machine for an answer
_NO_RESPONSE_TEXT = (
    f"Betaflight has not answered for {_RESPONSE_TIMEOUT:g} s, expected within a moment: "
    "fly again with less beside it on this machine"
)
_PRESSURE = 101325.0  # Pa
_EEPROM = "eeprom.bin"
_PROMPT = "# "


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """What gyro, accelerometer and attitude estimate report: [rad/s], [m/s^2], x, y, z, w."""

    w_WB_B: Array
    specific_force_B: Array
    q_WB_xyzw: Array


AT_REST = Sensed(
    w_WB_B=np.zeros(3),
    specific_force_B=np.array([0.0, 0.0, 9.81]),
    q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
)


class Firmware:
    """A running firmware; its time passes only in :meth:`step`."""

    def __init__(self, eeprom: bytes = b"") -> None:
        """Start it with the settings of an EEPROM; an empty one is as it comes.

        Raises :class:`UserError` where it is not installed.
        """
        shim, executable = shim_path(), firmware_path()
        self._serial: socket.socket | None = None
        self._sent = self._port = 0
        self._held = contextlib.ExitStack()
        self._finalizer = weakref.finalize(self, self._held.close)
        self._folder = Path(
            self._held.enter_context(
                tempfile.TemporaryDirectory(prefix="quad_mpc_ros_betaflight_")
            )
        )
        if eeprom:
            (self._folder / _EEPROM).write_bytes(eeprom)
        link, other = socket.socketpair()
        self._link = self._held.enter_context(link)
        self._link.settimeout(_RESPONSE_TIMEOUT)
        with other:
            process = subprocess.Popen(
                [executable],
                cwd=self._folder,
                env={
                    **os.environ,
                    "LD_PRELOAD": str(shim),
                    "QUAD_MPC_ROS_LINK": str(other.fileno()),
                    "QUAD_MPC_ROS_BOOT_NS": str(_BOOT_TIME_NS),
                },
                pass_fds=[other.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        self._held.callback(_end, process)
        try:
            self._answer()
        except OSError as error:
            raise RuntimeError(f"Betaflight does not start: {executable}") from error

    def connect(self) -> None:
        """Connect to its UART1, which speaks MSP and the command line, one at a time."""
        self._serial = self._held.enter_context(
            socket.create_connection(("127.0.0.1", self._port))
        )
        self._serial.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._serial.setblocking(False)

    def send(self, data: bytes) -> None:
        """Send over the connection; the next step begins with it."""
        assert self._serial is not None
        self._serial.sendall(data)
        self._sent = (self._sent + len(data)) % 2**32

    def received(self) -> bytes:
        """Return what has come over the connection, without waiting."""
        assert self._serial is not None
        try:
            return self._serial.recv(65536)
        except BlockingIOError:
            return b""

    def step(
        self,
        duration_ns: int,
        *,
        sensed: Sensed = AT_REST,
        channels: Sequence[int] = (),
    ) -> tuple[float, ...]:
        """Let its time pass; return the pulse widths of the four motors [us] at the end.

        It begins with all that was sent over :meth:`connect` until now. The sixteen ``channels``
        [us] are those of a separate receiver, which stays connected once given. Raises
        :class:`UserError` where it does not answer, as on a machine that starves it.
        """
        state = _packed(sensed)
        receiver = _RECEIVER.pack(0.0, *channels) if channels else b""
        head = _REQUEST.pack(duration_ns, self._sent, len(state), len(receiver))
        try:
            self._link.sendall(head + receiver + state)
            return self._answer()
        except TimeoutError as error:
            raise UserError(_NO_RESPONSE_TEXT) from error
        except OSError as error:
            raise FirmwareEndedError("Betaflight has ended") from error

    def memory(self) -> bytes:
        """Return its EEPROM as it is on the disk."""
        return (self._folder / _EEPROM).read_bytes()

    def close(self) -> None:
        """End the process."""
        self._finalizer()

    def _answer(self) -> tuple[float, ...]:
        data = self._link.recv(_ANSWER.size, socket.MSG_WAITALL)
        if len(data) < _ANSWER.size:
            raise ConnectionError("the link was closed")
        _, *motors, self._port, _ = _ANSWER.unpack(data)
        return tuple(motors)


class FirmwareEndedError(RuntimeError):
    """The process has ended, or restarted as it does after saving its settings."""


class Console:
    """The firmware's command line, over its connection; time passes meanwhile."""

    def __init__(self, firmware: Firmware) -> None:
        """Open it: from then on the firmware neither arms nor speaks MSP."""
        self._firmware = firmware
        self.say("#", end="")

    def say(self, line: str, *, end: str = "\n") -> str:
        """Return what it answers to a line, without the line and the prompt."""
        self._firmware.send(f"{line}{end}".encode())
        said, until = "", time.monotonic() + _RESPONSE_TIMEOUT
        while not said.endswith(_PROMPT):
            if time.monotonic() > until:
                raise UserError(f"{_NO_RESPONSE_TEXT} (in its command line, to {line!r})")
            self._firmware.step(_CLI_STEP_NS)
            said += self._firmware.received().decode(errors="replace")
        return said.removesuffix(_PROMPT).replace("\r", "").removeprefix(line).strip()

    def save(self) -> None:
        """Save the settings; the process ends with that."""
        with contextlib.suppress(FirmwareEndedError):
            self.say("save")


@functools.lru_cache(maxsize=64)
def eeprom(settings: tuple[str, ...]) -> bytes:
    """Return the memory of a firmware with these lines of its command line in force.

    Raises :class:`UserError` for a line that it refuses.
    """
    firmware = Firmware()
    firmware.connect()
    console = Console(firmware)
    for line in settings:
        said = console.say(line)
        if "###ERROR" in said or "UNKNOWN" in said:
            raise UserError(f"simulator.betaflight.settings: {line!r}: {said.splitlines()[0]}")
    console.save()
    memory = firmware.memory()
    firmware.close()
    return memory


def _packed(sensed: Sensed) -> bytes:
    """Return the state packet. Its time stands still, so that the firmware scales none."""
    wx, wy, wz = sensed.w_WB_B
    fx, fy, fz = sensed.specific_force_B
    qx, qy, qz, qw = sensed.q_WB_xyzw
    nowhere = (0.0,) * 6  # velocity and position are for its GPS
    return _STATE.pack(0.0, wx, -wy, -wz, -fx, -fy, -fz, qw, qx, qy, qz, *nowhere, _PRESSURE)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
