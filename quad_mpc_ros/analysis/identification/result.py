"""What an identification found, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.control.lie import Array


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """A fitted value with half of its 95 % interval.

    ``seen``: the flight excites it; ``observable``: the interval is narrow enough to be of use,
    which needs more than excitation. ``at_bound``: it is at a bound of the search, so no answer.
    """

    value: float
    half_width: float
    seen: bool
    observable: bool
    at_bound: bool = False


@dataclass(frozen=True, kw_only=True)
class ThrustOverVoltage:
    """The power of the battery's voltage over ``reference`` [V] that the thrust goes with.

    The thrust's scale is that at this voltage. Commands had compensated for the power
    ``compensated`` of it.
    """

    exponent: ParameterEstimate
    reference: float
    compensated: float

    @property
    def falls(self) -> bool:
        """Whether the thrust surely falls with the voltage."""
        return self.exponent.observable and self.exponent.value > self.exponent.half_width


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedCourse:
    """Measured and fitted over time, shapes (n,), (n, k), (n, k)."""

    time: Array
    measured: Array
    fitted: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """The fit: time constants and delay [s], thrust over that of the given vehicle, drag [1/s].

    Time constants of rates and torques, gains and drag are those of the body axes. What is not
    observable was held as given while the others were fitted; its estimate is that of the fit
    before. ``rotor_drag`` [1/s] is the drag that grows with the rotors' speed.

    ``thrust_scale`` is that of thrust per mass: no flight distinguishes the two.
    ``wind_acceleration_W`` (2,) [m/s^2] is the constant horizontal acceleration that was fitted
    beside them, wind above all. ``rates`` are body rates [rad/s], ``specific_force`` is along the
    thrust axis [m/s^2], averaged over a few odometries. ``over_voltage`` is None where the
    battery's voltage is not known. ``misfit`` is what the model leaves beyond noise of the body
    rates and of the velocity, as a share of what they vary. ``flown`` is the time under commands
    [s], ``fitted`` what of it was used.
    """

    rate_time_constant: tuple[ParameterEstimate, ...]
    torque_time_constant: tuple[ParameterEstimate, ...]
    rate_gain: tuple[ParameterEstimate, ...]
    thrust_time_constant: ParameterEstimate
    input_delay: ParameterEstimate
    thrust_scale: ParameterEstimate
    drag: tuple[ParameterEstimate, ...]
    translational_lift: ParameterEstimate
    rotor_drag: tuple[ParameterEstimate, ...]
    over_voltage: ThrustOverVoltage | None
    wind_acceleration_W: Array
    rate_residual: float
    velocity_residual: float
    misfit: tuple[float, float]
    rates: FittedCourse
    specific_force: FittedCourse
    flown: float
    fitted: float
