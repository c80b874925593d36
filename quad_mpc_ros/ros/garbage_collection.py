# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Garbage collection at times when no command is delayed."""

from __future__ import annotations

import gc


def freeze_gc() -> None:
    """Exclude all existing objects from garbage collection.

    A full collection in flight would take milliseconds.
    """
    gc.collect()
    gc.freeze()


def free_memory() -> None:
    """Free all unused objects, including excluded objects."""
    gc.unfreeze()
    for _ in range(3):  # freed objects may release others
        if not gc.collect():
            break


class GarbageCollection:
    """Garbage collection between control steps instead of at arbitrary times.

    A collection visits only objects created since :func:`freeze_gc`, and is short.
    """

    _TICKS = 50

    def __init__(self) -> None:
        self._ticks = 0
        gc.disable()

    def after_tick(self) -> None:
        """Collect periodically; called after the command was published."""
        self._ticks += 1
        if self._ticks % self._TICKS == 0:
            gc.collect()
