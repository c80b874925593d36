"""Reading ahead in a thread, so that opening a chunk does not delay what is due meanwhile."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")

_PATIENCE_S = 0.1


class _End:
    pass


class ReadAhead(Generic[T]):
    """An iterator over ``items`` that holds up to ``depth`` of them ready.

    What their iteration raises is raised here in its turn.
    """

    def __init__(self, items: Iterator[T], *, depth: int) -> None:
        self._ready: queue.Queue[T | BaseException | _End] = queue.Queue(depth)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._read, args=(items,), daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        item = self._ready.get()
        if isinstance(item, _End):
            self._ready.put(item)
            raise StopIteration
        if isinstance(item, BaseException):
            raise item
        return item

    def close(self) -> None:
        """End the reading."""
        self._closed.set()
        self._thread.join()

    def _read(self, items: Iterator[T]) -> None:
        try:
            for item in items:
                if not self._put(item):
                    return
        except Exception as error:
            self._put(error)
        self._put(_End())

    def _put(self, item: T | BaseException | _End) -> bool:
        while not self._closed.is_set():
            try:
                self._ready.put(item, timeout=_PATIENCE_S)
                return True
            except queue.Full:
                continue
        return False
