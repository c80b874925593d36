"""What a fault does to a stream of messages.

A distortion is a pure function of the message that would have come, the last one before the fault
and the time since the fault began. It returns what comes instead: nothing, another message,
several, or the same one later. They serve a relay between processes and a loop in one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

M = TypeVar("M", OdometrySample, ReferenceWindow)
_SECOND = 1_000_000_000


class Delivery(NamedTuple, Generic[M]):
    """A message that comes ``delay_ns`` late, from the usual publisher or from an ``intruder``."""

    message: M
    delay_ns: int = 0
    intruder: bool = False


Distortion = Callable[[M, M, int], Sequence[Delivery[M]]]
"""``(message, before, elapsed_ns)`` to what comes instead of the message."""

Change = Callable[[Any], Any]
"""The value of a field to what it becomes."""


def lost(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let nothing come."""
    return ()


def repeated(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let the last message come again and again, as it was."""
    return (Delivery(before),)


def frozen(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let the last message come again and again under the stamp of the moment."""
    return (Delivery(dataclasses.replace(before, stamp_ns=message.stamp_ns)),)


def running_backwards(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let the stamps run backwards from the last one on, as fast as they ran forwards."""
    stamp_ns = 2 * before.stamp_ns - message.stamp_ns
    return (Delivery(dataclasses.replace(message, stamp_ns=stamp_ns)),)


def sometimes_from_the_future(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Stamp one message in ten as of ten seconds later."""
    if elapsed_ns // 20_000_000 % 10:
        return (Delivery(message),)
    return (Delivery(dataclasses.replace(message, stamp_ns=message.stamp_ns + 10 * _SECOND)),)


def dropping(share: float) -> Distortion[M]:
    """Lose a share of the messages at random, drawn from the time so that it can be repeated."""

    def dropped(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
        drawn = np.random.default_rng(elapsed_ns // 1_000_000).random()
        return () if drawn < share else (Delivery(message),)

    return dropped


def in_bursts(seconds: float) -> Distortion[M]:
    """Hold everything back and let it come at once, every so many seconds."""
    period_ns = round(seconds * _SECOND)

    def late(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
        return (Delivery(message, delay_ns=period_ns - elapsed_ns % period_ns),)

    return late


def changed(**fields: Change) -> Distortion[M]:
    """Change fields of every message."""
    return lambda message, before, elapsed_ns: (Delivery(_with_changed(message, fields)),)


def now_and_then(seconds: float, distortion: Distortion[M]) -> Distortion[M]:
    """Distort for so many seconds, then not for as long, and so on."""
    period_ns = round(seconds * _SECOND)

    def alternating(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
        if elapsed_ns // period_ns % 2:
            return (Delivery(message),)
        return distortion(message, before, elapsed_ns)

    return alternating


def doubled(**fields: Change) -> Distortion[M]:
    """Let a second publisher send every message again, with changed fields."""
    return lambda message, before, elapsed_ns: (
        Delivery(message),
        Delivery(_with_changed(message, fields), intruder=True),
    )


def shifted_in_time(seconds: float) -> Distortion[M]:
    """Shift every stamp."""
    return changed(stamp_ns=lambda stamp_ns: stamp_ns + round(seconds * _SECOND))


def moved(x: float, y: float, z: float) -> Change:
    """Return the change that moves positions (..., 3) [m]."""
    return lambda p_WB: p_WB + np.array([x, y, z])


def not_a_number(values: Array) -> Array:
    """Make every number of a field NaN."""
    return np.full_like(values, np.nan)


def elsewhere(frame_id: str) -> str:
    """Name another frame."""
    return "elsewhere"


def _with_changed(message: M, fields: Mapping[str, Change]) -> M:
    new = {name: change(getattr(message, name)) for name, change in fields.items()}
    return dataclasses.replace(message, **new)
