"""The low-pass filters of the rate loop."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array

Section = tuple[tuple[float, float, float], tuple[float, float]]
"""Coefficients b and a (without a_0 = 1) of a filter of second order."""


def butterworth(cutoff: float, rate: float) -> Section:
    """Return a low-pass of second order, ``cutoff`` and ``rate`` in Hz; 0 lets everything pass.

    The bilinear transform of 1 / (s^2 + sqrt(2) s + 1), bent so that the cut-off stays.
    """
    if cutoff == 0.0:
        return (1.0, 0.0, 0.0), (0.0, 0.0)
    k = math.tan(math.pi * cutoff / rate)
    norm = 1.0 + math.sqrt(2.0) * k + k * k
    b = k * k / norm
    return (b, 2.0 * b, b), (2.0 * (k * k - 1.0) / norm, (1.0 - math.sqrt(2.0) * k + k * k) / norm)


def smoothing(cutoff: float, rate: float) -> float:
    """Return which share of a new value a low-pass of first order takes; Hz, 0 takes all."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff / rate) if cutoff > 0.0 else 1.0


@compiled
def filtered(value: float, section: Section, held: Array) -> float:
    """Return what a filter of second order makes of the next value; ``held`` (2,) is its state."""
    (b0, b1, b2), (a1, a2) = section
    out = b0 * value + held[0]
    held[0] = b1 * value - a1 * out + held[1]
    held[1] = b2 * value - a2 * out
    return float(out)


@compiled
def settle(value: float, section: Section, held: Array) -> None:
    """Set the state (2,) of a filter as if a value had always been there."""
    (_, b1, b2), (a1, a2) = section
    held[1] = (b2 - a2) * value
    held[0] = (b1 - a1) * value + held[1]
