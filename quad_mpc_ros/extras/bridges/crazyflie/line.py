"""A link to a Crazyflie by cflib."""

from __future__ import annotations

import contextlib
import importlib
import queue
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.ros.bridges.line import ReconnectingLine

_MAX_QUEUED = 64  # packets


@dataclass(frozen=True, kw_only=True)
class CrazyflieLink:
    """A link to a Crazyflie in place of a serial line, by its address as cflib writes it."""

    uri: str
    period: float = 0.005
    """How often it is read [s]."""

    def open(self) -> CrazyflieLine:
        """Return the line to it."""
        return CrazyflieLine(self)


class CrazyflieLine(ReconnectingLine):
    """Packets, each after its length."""

    def __init__(self, link: CrazyflieLink) -> None:
        super().__init__(link.uri)
        self._crtp = importlib.import_module("cflib.crtp")
        if not self._crtp.CLASSES:
            self._crtp.init_drivers()
        self._driver: Any = None
        self._errors: deque[str] = deque(maxlen=1)
        self._sender: _Sender | None = None
        self._reader = crtp.PacketReader()

    def read(self) -> bytes:
        """Return what has come, each packet after its length."""
        if self._driver is None and not self._reconnect():
            return b""
        found = b""
        while (received := self._driver.receive_packet(0)) is not None:
            data = bytes(received.data)
            found += bytes((1 + len(data), received.header)) + data
        if self._errors:
            error, _, _ = self._errors.pop().partition("\n")
            self.fault = f"{self._name}: {error}"
            self._release()
        return found

    def write(self, data: bytes) -> None:
        """Send packets, each after its length."""
        for packet in self._reader.read(data):
            if self._sender is not None:
                self._sender.put(packet)

    def close(self) -> None:
        """Close the link."""
        sender = self._release()
        if sender is not None:
            sender.join()

    def _open(self) -> None:
        self._errors = deque(maxlen=1)  # of this driver alone, whose own thread adds to it
        try:
            driver = self._crtp.get_link_driver(self._name, None, self._errors.append)
        except Exception as error:
            raise OSError(error) from error
        if driver is None:
            raise OSError("expected radio://, usb:// or udp:// as cflib writes them")
        self._driver, self._sender = driver, _Sender(driver)
        self._sender.start()

    def _release(self) -> _Sender | None:
        """Let the sender close the driver, which may take a second."""
        sender, self._driver, self._sender = self._sender, None, None
        if sender is not None:
            sender.put(None)
        return sender


class _Sender(threading.Thread):
    """Sends packets of one driver: a radio keeps its caller waiting until it gets an answer."""

    def __init__(self, driver: Any) -> None:
        super().__init__(daemon=True)
        self._driver = driver
        self._packet = importlib.import_module("cflib.crtp.crtpstack").CRTPPacket
        self._waiting: queue.Queue[crtp.Packet | None] = queue.Queue(_MAX_QUEUED)

    def put(self, packet: crtp.Packet | None) -> None:
        """Send a packet after those that wait, or None to end; the oldest makes room."""
        while True:
            try:
                self._waiting.put_nowait(packet)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._waiting.get_nowait()

    def run(self) -> None:
        """Send until the end, and close the driver."""
        while (packet := self._waiting.get()) is not None:
            self._driver.send_packet(self._packet(packet.header, packet.data))
        self._driver.close()
