"""The low-pass filters of the rate loop."""

from __future__ import annotations

import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray
from quad_mpc_ros.control.lie import Array


class FilterSection(Record):
    """Coefficients b and a (a_0 = 1) of a filter of second order."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


def butterworth(cutoff: float, rate: float) -> RecordArray[FilterSection]:
    """Return a low-pass of second order, ``cutoff`` and ``rate`` in Hz; 0 disables the filter.

    The bilinear transform of 1 / (s^2 + sqrt(2) s + 1), prewarped so that the cut-off is kept.
    """
    section = FilterSection.zeros()
    own = section[()]
    if cutoff == 0.0:
        own.b0 = 1.0
        return section
    k = math.tan(math.pi * cutoff / rate)
    norm = 1.0 + math.sqrt(2.0) * k + k * k
    own.b0 = own.b2 = k * k / norm
    own.b1 = 2.0 * own.b0
    own.a1 = 2.0 * (k * k - 1.0) / norm
    own.a2 = (1.0 - math.sqrt(2.0) * k + k * k) / norm
    return section


def smoothing(cutoff: float, rate: float) -> float:
    """Return the weight of a new value in a first-order low-pass; Hz, 1 if the cutoff is 0."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff / rate) if cutoff > 0.0 else 1.0


@compiled
def filtered(value: float, section: FilterSection, held: Array) -> float:
    """Return the output of a filter of second order; ``held`` (2,) is its state."""
    out = section.b0 * value + held[0]
    held[0] = section.b1 * value - section.a1 * out + held[1]
    held[1] = section.b2 * value - section.a2 * out
    return float(out)


@compiled
def initialize(value: float, section: FilterSection, held: Array) -> None:
    """Set the state (2,) of a filter to the steady state of a value."""
    held[1] = (section.b2 - section.a2) * value
    held[0] = (section.b1 - section.a1) * value + held[1]
