"""Reads the fields of a message from its bytes one after another, in either byte order.

CDR as in :mod:`.cdr`. For messages of any content, which need not come at every tick.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

_SECOND = 1_000_000_000
_BEGIN = 4  # encapsulation; alignment counts from its end
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}


class CdrReader:
    """Reads on from where the last field ended.

    Every method raises ``ValueError`` where the bytes end early or are no such field.
    """

    def __init__(self, data: bytes) -> None:
        """Begin behind the encapsulation of a message."""
        order = _ORDERS.get(bytes(data[:2]))
        if order is None or len(data) < _BEGIN:
            raise ValueError(f"{len(data)} bytes that do not begin as a message does")
        self.order = order
        """``<`` or ``>``, as for :mod:`struct` and NumPy."""
        self._data, self._at = data, _BEGIN

    def number(self, kind: str) -> int | float:
        """Return a number of a kind of :mod:`struct`."""
        return self.numbers(kind, 1)[0]

    def whole(self, kind: str = "I") -> int:
        """Return a whole number of a kind of :mod:`struct`."""
        return int(self.number(kind))

    def numbers(self, kind: str, count: int) -> tuple[int | float, ...]:
        """Return some numbers of a kind of :mod:`struct`."""
        size = struct.calcsize(kind)
        at = self._take(size * count, align=size)
        return struct.unpack_from(f"{self.order}{count}{kind}", self._data, at)

    def array(self, kind: str, count: int) -> NDArray[np.float64]:
        """Return as many numbers of a NumPy kind (``f8``) as floats (count,)."""
        dtype = np.dtype(f"{self.order}{kind}")
        if count == 0:  # to what is not there nothing is aligned
            return np.zeros(0)
        at = self._take(dtype.itemsize * count, align=dtype.itemsize)
        return np.frombuffer(self._data, dtype, count, at).astype(np.float64)

    def text(self) -> str:
        """Return a text."""
        length = self.whole()
        at = self._take(length)
        try:
            return bytes(self._data[at : at + length]).rstrip(b"\0").decode()
        except UnicodeDecodeError as error:
            raise ValueError("a text that is not UTF-8") from error

    def octets(self) -> memoryview:
        """Return a sequence of bytes."""
        length = self.whole()
        at = self._take(length)
        return memoryview(self._data)[at : at + length]

    def time_ns(self) -> int:
        """Return a ``builtin_interfaces`` Time or Duration [ns]."""
        return self.whole("i") * _SECOND + self.whole()

    def header(self) -> tuple[int, str]:
        """Return the stamp [ns] and the frame of a ``std_msgs/Header``."""
        return self.time_ns(), self.text()

    def length(self, *, least: int) -> int:
        """Return the length of a sequence whose elements take at ``least`` that many bytes."""
        count = self.whole()
        left = len(self._data) - self._at
        if count * least > left:
            raise ValueError(f"a sequence of {count} elements in {left} bytes")
        return count

    def skip(self, size: int, *, align: int = 1) -> None:
        """Leave out some bytes."""
        self._take(size, align=align)

    def _take(self, size: int, *, align: int = 1) -> int:
        at = self._at + (_BEGIN - self._at) % align
        if at + size > len(self._data):
            raise ValueError(f"{len(self._data)} bytes, which end early")
        self._at = at + size
        return at
