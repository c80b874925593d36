"""The motion of the deck: sines of time."""

from __future__ import annotations

import math
from typing import NamedTuple

from quad_mpc_ros.extras.plants.mujoco.model import HEAVE, PITCH, ROLL
from quad_mpc_ros.simulation.mujoco_parameters import DeckParameters


class Sine(NamedTuple):
    """amplitude sin(2 pi frequency t + phase); in m or rad, Hz, rad."""

    amplitude: float
    frequency: float
    phase: float

    def value(self, seconds: float) -> float:
        """Return the value at a time [s]."""
        return self.amplitude * math.sin(math.tau * self.frequency * seconds + self.phase)

    def rate(self, seconds: float) -> float:
        """Return the derivative at a time [s]."""
        omega = math.tau * self.frequency
        return self.amplitude * omega * math.cos(omega * seconds + self.phase)


def deck_motions(deck: DeckParameters) -> dict[str, Sine]:
    """Return the motions of the deck's joints: heave [m], pitch [rad] and roll [rad]."""
    return {
        HEAVE: Sine(deck.heave_amplitude, deck.heave_frequency, deck.heave_phase),
        PITCH: Sine(deck.pitch_amplitude, deck.rock_frequency, deck.pitch_phase),
        ROLL: Sine(deck.roll_amplitude, deck.rock_frequency, deck.roll_phase),
    }
