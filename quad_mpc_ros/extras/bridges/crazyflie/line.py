# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Link to a Crazyflie with cflib."""

from __future__ import annotations

import contextlib
import importlib
import queue
import threading
from collections import deque
from typing import Any

from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.ros.bridges.line import ReconnectingLine

_MAX_QUEUED = 64  # packets


class CrazyflieLine(ReconnectingLine):
    """A stream of packets, each preceded by its length, to an address in cflib's format."""

    def __init__(self, uri: str) -> None:
        super().__init__(uri)
        self._errors: deque[str] = deque(maxlen=1)
        self._sender: _Sender | None = None
        self._reader = crtp.PacketReader()

    def _receive(self) -> bytes:
        found = b""
        while (received := self._end.receive_packet(0)) is not None:
            data = bytes(received.data)
            found += bytes((1 + len(data), received.header)) + data
        if self._errors:
            error, _, _ = self._errors.pop().partition("\n")
            self.fault = f"{self._name}: {error}"
            self._release()
        return found

    def _send(self, data: bytes) -> None:
        for packet in self._reader.read(data):
            if self._sender is not None:
                self._sender.put(packet)

    def close(self) -> None:
        """Close the link."""
        sender = self._release()
        if sender is not None:
            sender.join()

    def _open(self) -> Any:
        cflib_crtp = importlib.import_module("cflib.crtp")
        if not cflib_crtp.CLASSES:
            cflib_crtp.init_drivers()
        self._errors = deque(maxlen=1)  # only of this driver, whose thread appends to it
        try:
            driver = cflib_crtp.get_link_driver(self._name, None, self._errors.append)
        except Exception as error:
            raise OSError(error) from error
        if driver is None:
            raise OSError("expected radio://, usb:// or udp:// in cflib's format")
        self._sender = _Sender(driver)
        self._sender.start()
        return driver

    def _release(self) -> _Sender | None:
        """Let the sender close the driver, which can take a second."""
        sender, self._end, self._sender = self._sender, None, None
        if sender is not None:
            sender.put(None)
        return sender


class _Sender(threading.Thread):
    """Sends packets in a thread, because a radio blocks its caller until it receives an answer."""

    def __init__(self, driver: Any) -> None:
        super().__init__(daemon=True)
        self._driver = driver
        self._packet = importlib.import_module("cflib.crtp.crtpstack").CRTPPacket
        self._waiting: queue.Queue[crtp.Packet | None] = queue.Queue(_MAX_QUEUED)

    def put(self, packet: crtp.Packet | None) -> None:
        """Queue a packet, or None to end; drop the oldest packet of a full queue."""
        while True:
            try:
                self._waiting.put_nowait(packet)
                return
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._waiting.get_nowait()

    def run(self) -> None:
        """Send packets until the end, then close the driver."""
        while (packet := self._waiting.get()) is not None:
            self._driver.send_packet(self._packet(packet.header, packet.data))
        self._driver.close()
