"""From the command in force to what the motors do: first-order lags.

The plant's own, apart from those of ``model/rollout.py`` on purpose.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.state import Input
from quad_mpc_ros.simulation.dynamics import InputCourse, held


class ActuatorLag:
    """Body rates and throttle that follow the command c as d y/dt = (c - y) / tau.

    The time constants are in seconds; with 0 the command is followed at once. It is the throttle
    signal that lags, the thrust follows by the curve. The controller's model has a lag of its own
    (``model/actuators.py``), on purpose: a mistake that both shared would not show.
    """

    def __init__(
        self, *, rate_time_constant: float, thrust_time_constant: float, initial: Input
    ) -> None:
        self._rate_tau = rate_time_constant
        self._thrust_tau = thrust_time_constant
        self._command = initial
        self.u = initial
        """The true throttle and body rates."""
        self.shortest_time_constant = min(
            (tau for tau in (rate_time_constant, thrust_time_constant) if tau > 0.0),
            default=math.inf,
        )
        """The faster of the lags that there are [s]; infinite without any."""

    def follow(self, command: Input) -> None:
        """Follow another command from now on."""
        self._command = command
        self.u = self._after(self.u, 0.0)

    def course(self, duration: float) -> InputCourse:
        """Return what the input will be over ``duration`` [s], without going there."""
        if self.shortest_time_constant == math.inf:
            return held(self.u, duration=duration)
        half = 0.5 * duration
        middle = self._after(self.u, half)
        return InputCourse(
            start=self.u,
            middle=middle,
            end=self._after(middle, half),
            first_turn=self._turn(self.u.w_WB_B, half),
            second_turn=self._turn(middle.w_WB_B, half),
        )

    def finish(self, course: InputCourse) -> None:
        """Go to the end of a course."""
        self.u = course.end

    def stop_turning(self) -> None:
        """Let something hold the body: rates that lag start again from zero."""
        if self._rate_tau > 0.0:
            self.u = Input(throttle=self.u.throttle, w_WB_B=np.zeros(3))

    def _after(self, u: Input, duration: float) -> Input:
        c = self._command
        return Input(
            throttle=c.throttle + _decay(duration, self._thrust_tau) * (u.throttle - c.throttle),
            w_WB_B=c.w_WB_B + _decay(duration, self._rate_tau) * (u.w_WB_B - c.w_WB_B),
        )

    def _turn(self, w_WB_B: Array, h: float) -> Array:
        """Return the rotation (3, 3) over ``h`` [s] of the body rate c + d exp(-t / tau).

        The Magnus expansion of R' = R [omega] to its second term, both integrals in closed form:
        the integral of omega, and half that of omega(s) x omega(t) over s < t. What is left out
        is of order h^5 (Blanes, Casas, Oteo, Ros, "The Magnus expansion and some of its
        applications", 2009; its sign of the second term is for R' = [omega] R).
        """
        tau, c = self._rate_tau, self._command.w_WB_B
        if tau == 0.0:
            return so3.exp(h * c)
        d = w_WB_B - c
        decay = math.exp(-h / tau)
        first = h * c + tau * (1.0 - decay) * d
        second = tau * tau * (1.0 - decay) - 0.5 * tau * h * (1.0 + decay)
        return so3.exp(first + second * so3.cross(c, d))


def _decay(duration: float, time_constant: float) -> float:
    return math.exp(-duration / time_constant) if time_constant > 0.0 else 0.0
