"""How the deck moves: sines of time."""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.simulation.mujoco_parameters import DeckParameters


class Sway(NamedTuple):
    """A degree of freedom at a time: value, rate, and mean acceleration over a step."""

    value: float
    rate: float
    acceleration: float


class Sine(NamedTuple):
    """amplitude sin(2 pi frequency t + phase); in m or rad, Hz, rad."""

    amplitude: float
    frequency: float
    phase: float

    def value(self, seconds: float) -> float:
        """Return it at a time."""
        return self.amplitude * math.sin(math.tau * self.frequency * seconds + self.phase)

    def rate(self, seconds: float) -> float:
        """Return its derivative at a time."""
        omega = math.tau * self.frequency
        return self.amplitude * omega * math.cos(omega * seconds + self.phase)

    def at(self, seconds: float, *, duration: float) -> Sway:
        """Return where it is, and what brings it over a step to its rate thereafter."""
        rate = self.rate(seconds)
        after = self.rate(seconds + duration)
        return Sway(self.value(seconds), rate, (after - rate) / duration)


def heave(deck: DeckParameters) -> Sine:
    """Return the height of the middle of its upper face, from that at rest [m]."""
    return Sine(deck.heave_amplitude, deck.heave_frequency, deck.heave_phase)


def roll(deck: DeckParameters) -> Sine:
    """Return its angle about x [rad]."""
    return Sine(deck.roll_amplitude, deck.rock_frequency, deck.roll_phase)


def pitch(deck: DeckParameters) -> Sine:
    """Return its angle about y [rad]."""
    return Sine(deck.pitch_amplitude, deck.rock_frequency, deck.pitch_phase)
