"""The random numbers of a simulation: one seed, and one stream of numbers for each purpose.

As the streams are independent, neither the order in which gusts and sensors draw nor an effect
that is switched on changes the numbers of another.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What random numbers are for. The numbers are part of what a seed means: never renumber."""

    GUSTS = 0
    NOISE = 1
    DROPOUT = 2
    JITTER = 3


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """Return the generator of a stream at its beginning."""
    return np.random.default_rng([seed, stream])
