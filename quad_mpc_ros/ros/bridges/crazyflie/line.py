"""A link to a Crazyflie by cflib, which may be lost: it is opened again."""

from __future__ import annotations

import importlib
import queue
import threading
import time
from typing import Any

from quad_mpc_ros.messages import crtp
from quad_mpc_ros.ros.bridges.bridge import CrazyflieLink

_AGAIN = 1.0  # s
_MOST_WAITING = 64  # packets


class CrazyflieLine:
    """Reads and writes packets without waiting; ``fault`` is why it cannot."""

    def __init__(self, link: CrazyflieLink) -> None:
        self.fault = ""
        self._uri = link.uri
        self._crtp = importlib.import_module("cflib.crtp")
        self._packet = importlib.import_module("cflib.crtp.crtpstack").CRTPPacket
        if not self._crtp.CLASSES:
            self._crtp.init_drivers()
        self._driver: Any = None
        self._tried: float | None = None
        self._reader = crtp.Reader()
        # A radio keeps a sender waiting for as long as there is no answer.
        self._waiting: queue.Queue[crtp.Packet | None] = queue.Queue(_MOST_WAITING)
        self._sender: threading.Thread | None = None

    def read(self) -> bytes:
        """Return what has come, each packet after its length."""
        if self._driver is None and not self._open():
            return b""
        found = b""
        while (received := self._driver.receive_packet(0)) is not None:
            data = bytes(received.data)
            found += bytes((1 + len(data), received.header)) + data
        if self.fault:  # by the driver's own thread
            self.close()
        return found

    def write(self, data: bytes) -> None:
        """Send packets, each after its length; when too many wait, the oldest is dropped."""
        for packet in self._reader.read(data):
            if self._driver is None:
                continue
            while True:
                try:
                    self._waiting.put_nowait(packet)
                    break
                except queue.Full:
                    self._drop()

    def close(self) -> None:
        """Close the link."""
        driver, sender, self._driver, self._sender = self._driver, self._sender, None, None
        if sender is not None:
            while self._drop():
                pass
            self._waiting.put(None)
            sender.join()
        if driver is not None:
            driver.close()

    def _open(self) -> bool:
        now = time.monotonic()
        if self._tried is not None and now - self._tried < _AGAIN:
            return False
        self._tried = now
        try:
            driver = self._crtp.get_link_driver(self._uri, None, self._on_error)
        except Exception as error:
            self.fault = f"{self._uri}: {error}"
            return False
        if driver is None:
            self.fault = f"{self._uri}: expected radio://, usb:// or udp:// as cflib writes them"
            return False
        self.fault, self._driver = "", driver
        self._sender = threading.Thread(target=self._send, args=(driver,), daemon=True)
        self._sender.start()
        return True

    def _send(self, driver: Any) -> None:
        while (packet := self._waiting.get()) is not None:
            driver.send_packet(self._packet(packet.header, packet.data))

    def _drop(self) -> bool:
        try:
            self._waiting.get_nowait()
        except queue.Empty:
            return False
        return True

    def _on_error(self, message: str) -> None:
        self.fault = f"{self._uri}: {message.splitlines()[0]}"
