"""What a fault does to a stream of messages.

A distortion is a pure function of the message that would have come, the last one before the fault
and the time since the fault began. It returns what comes instead: nothing, another message,
several, or the same one later. They serve a relay between processes and a loop in one. At the end
are changes of single messages into such as nobody should fly.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow

M = TypeVar("M", OdometrySample, ReferenceWindow)
_SECOND = 1_000_000_000

_FAR = np.array([1000.0, 1000.0, 0.0])  # m
_ASIDE = np.array([2.0, -1.0, 1.0])  # m
_A_LITTLE_ASIDE = np.array([0.5, 0.0, 0.0])  # m


class Delivery(NamedTuple, Generic[M]):
    """A message that comes ``delay_ns`` late, from the usual publisher or from an ``intruder``."""

    message: M
    delay_ns: int = 0
    intruder: bool = False


Distortion = Callable[[M, M, int], Sequence[Delivery[M]]]
"""``(message, before, elapsed_ns)`` to what comes instead of the message."""


def lost(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let nothing come."""
    return ()


def changed(change: Callable[[M], M]) -> Distortion[M]:
    """Change every message."""
    return lambda message, before, elapsed_ns: (Delivery(change(message)),)


def repeated(message: M, before: M, elapsed_ns: int) -> Sequence[Delivery[M]]:
    """Let the last message come again and again, as it was."""
    return (Delivery(before),)


def frozen(
    message: OdometrySample, before: OdometrySample, elapsed_ns: int
) -> Sequence[Delivery[OdometrySample]]:
    """Let the last odometry come again and again under the stamp of the moment."""
    return (Delivery(dataclasses.replace(before, stamp_ns=message.stamp_ns)),)


def shifted_in_time(seconds: float) -> Distortion[OdometrySample]:
    """Shift every stamp."""
    shift_ns = round(seconds * _SECOND)
    return changed(lambda o: dataclasses.replace(o, stamp_ns=o.stamp_ns + shift_ns))


def running_backwards(
    message: OdometrySample, before: OdometrySample, elapsed_ns: int
) -> Sequence[Delivery[OdometrySample]]:
    """Let the stamps run backwards from the last one on, as fast as they ran forwards."""
    stamp_ns = 2 * before.stamp_ns - message.stamp_ns
    return (Delivery(dataclasses.replace(message, stamp_ns=stamp_ns)),)


def sometimes_from_the_future(
    message: OdometrySample, before: OdometrySample, elapsed_ns: int
) -> Sequence[Delivery[OdometrySample]]:
    """Stamp one odometry in ten as of ten seconds later."""
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


def doubled(change: Callable[[M], M]) -> Distortion[M]:
    """Let a second publisher send every message again, changed."""
    return lambda message, before, elapsed_ns: (
        Delivery(message),
        Delivery(change(message), intruder=True),
    )


def not_a_number(odometry: OdometrySample) -> OdometrySample:
    """Make the position NaN."""
    return dataclasses.replace(odometry, p_WB=np.full(3, np.nan))


def in_another_frame(odometry: OdometrySample) -> OdometrySample:
    """Name another world frame."""
    return dataclasses.replace(odometry, frame_id="elsewhere")


def not_of_unit_length(odometry: OdometrySample) -> OdometrySample:
    """Make the quaternion too long."""
    return dataclasses.replace(odometry, q_WB_xyzw=1.1 * odometry.q_WB_xyzw)


def aside(odometry: OdometrySample) -> OdometrySample:
    """Move the position, as an estimator does that finds itself somewhere else."""
    return dataclasses.replace(odometry, p_WB=odometry.p_WB + _ASIDE)


def of_another_estimator(odometry: OdometrySample) -> OdometrySample:
    """Move the position as far as two estimators differ, a millisecond later."""
    return dataclasses.replace(
        odometry, p_WB=odometry.p_WB + _A_LITTLE_ASIDE, stamp_ns=odometry.stamp_ns + 1_000_000
    )


def reference_not_a_number(window: ReferenceWindow) -> ReferenceWindow:
    """Make every velocity NaN."""
    return dataclasses.replace(window, v_WB_W=np.full_like(window.v_WB_W, np.nan))


def reference_empty(window: ReferenceWindow) -> ReferenceWindow:
    """Leave no sample."""
    arrays = {
        field.name: getattr(window, field.name)[:0]
        for field in dataclasses.fields(window)
        if isinstance(getattr(window, field.name), np.ndarray)
    }
    return dataclasses.replace(window, **arrays)


def reference_in_another_frame(window: ReferenceWindow) -> ReferenceWindow:
    """Name another world frame."""
    return dataclasses.replace(window, frame_id="elsewhere")


def reference_not_of_unit_length(window: ReferenceWindow) -> ReferenceWindow:
    """Make every quaternion zero."""
    return dataclasses.replace(window, q_WB_xyzw=np.zeros_like(window.q_WB_xyzw))


def reference_far_away(window: ReferenceWindow) -> ReferenceWindow:
    """Move the reference by more than a kilometre."""
    return dataclasses.replace(window, p_WB=window.p_WB + _FAR)


def reference_of_another_server(window: ReferenceWindow) -> ReferenceWindow:
    """Move the reference a little."""
    return dataclasses.replace(window, p_WB=window.p_WB + _A_LITTLE_ASIDE)
