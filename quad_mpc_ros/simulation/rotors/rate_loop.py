# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The rate loop of an autopilot: from throttle, commanded rates and gyro to speeds of the rotors.

For each axis, with the error e = w_c - w of the filtered gyro w,

    alpha = P e + I int e - D dw/dt

The derivative is filtered once more; the torque demand is alpha times the diagonal of the inertia.
The integral is limited, and held while its torque saturates in its direction. On the ground the
integral is zero and airmode, which could lift the vehicle off, is disabled.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.motion import thrust_at
from quad_mpc_ros.simulation.rotors.mixer import mixed
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters


class FilterSection(Record):
    """Coefficients b and a (a_0 = 1) of a filter of second order."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


class Loop(Record):
    """The parameters of a rate loop, and numbers computed from them."""

    period: float  # s
    p: Vector3
    i: Vector3
    d: Vector3
    integral_max: Vector3
    torque_max: Vector3
    inertia: Vector3  # diagonal [kg m^2]
    gyro: FilterSection
    smoothing: float
    thrust_curve: Vector3  # of all rotors together [N]
    thrust_coefficient: float
    least: float  # minimum thrust of a rotor [N]
    greatest: float  # maximum thrust of a rotor [N]


class Memory(Record):
    """State of a rate loop."""

    integral: Vector3  # rad/s^2
    gyro: Annotated[Array, (3, 2)]  # state of the filter
    before: Vector3  # filtered rate of the last run [rad/s]
    slope: Vector3  # filtered derivative of the filtered rate [rad/s^2]


def loop_of(config: RotorsPlantParameters) -> RecordArray[Loop]:
    """Return the configured rate loop, with the nominal thrust of the rotors."""
    settings, rotors, loop = config.rate_loop, config.rotors, Loop.zeros()
    own = loop[()]
    own.period = 1.0 / settings.rate
    own.p[:], own.i[:], own.d[:] = settings.p, settings.i, settings.d
    own.integral_max[:], own.torque_max[:] = settings.integral_max, settings.torque_max
    own.inertia[:] = config.airframe.inertia[:3]
    own.gyro = butterworth(settings.gyro_cutoff, settings.rate)[()]
    own.smoothing = smoothing(settings.d_cutoff, settings.rate)
    own.thrust_curve[:] = [config.motor_count * each for each in config.thrust_curve]
    own.thrust_coefficient = rotors.thrust_coefficient
    own.least = rotors.thrust_coefficient * rotors.speed_min**2
    own.greatest = rotors.thrust_coefficient * rotors.speed_max**2
    return loop


def begun(w_WB_B: Array, loop: RecordArray[Loop]) -> RecordArray[Memory]:
    """Return the memory of a loop at constant rates (3,) [rad/s]."""
    memory = Memory.zeros()
    own = memory[()]
    own.before[:] = w_WB_B
    for axis in range(3):
        initialize(w_WB_B[axis], section=loop[()].gyro, held=own.gyro[axis])
    return memory


@compiled
def run(
    memory: RecordArray[Memory],
    w_WB_B: Array,
    throttle: float,
    rates: Array,
    on_ground: bool,
    loop: RecordArray[Loop],
    mix: Array,
    out: Array,
) -> None:
    """Run the loop once: write the commanded rotor speeds (n,) [rad/s] into ``out``.

    ``w_WB_B`` (3,) is the gyro, ``throttle`` and ``rates`` (3,) the command.
    """
    x, settings = memory[()], loop[()]
    error, wanted = np.empty(3), np.empty(3)
    for axis in range(3):
        rate = _measured(x, axis=axis, gyro=w_WB_B[axis], loop=settings)
        error[axis] = rates[axis] - rate
        alpha = settings.p[axis] * error[axis] + x.integral[axis]
        wanted[axis] = settings.inertia[axis] * (alpha - settings.d[axis] * x.slope[axis])
    demand = _limited(wanted, settings.torque_max)
    airmode = not on_ground
    turn, yaw = speeds(throttle, demand, airmode=airmode, loop=settings, mix=mix, out=out)
    for axis in range(3):
        share = turn if axis < 2 else yaw
        saturated = share < 1.0 or demand[axis] != wanted[axis]
        if on_ground:
            x.integral[axis] = 0.0
        elif not (saturated and error[axis] * wanted[axis] > 0.0):
            step = settings.period * settings.i[axis] * error[axis]
            most = settings.integral_max[axis]
            x.integral[axis] = kernels.clamp(x.integral[axis] + step, -most, most)


@compiled
def _measured(memory: Memory, axis: int, gyro: float, loop: Loop) -> float:
    """Return the filtered rate of an axis [rad/s]; update its filtered slope [rad/s^2]."""
    rate = filtered(gyro, section=loop.gyro, held=memory.gyro[axis])
    slope = (rate - memory.before[axis]) / loop.period
    memory.before[axis] = rate
    memory.slope[axis] += loop.smoothing * (slope - memory.slope[axis])
    return rate


@compiled
def _limited(torque: Array, most: Array) -> kernels.Vector:
    return (
        kernels.clamp(torque[0], -most[0], most[0]),
        kernels.clamp(torque[1], -most[1], most[1]),
        kernels.clamp(torque[2], -most[2], most[2]),
    )


@compiled
def speeds(
    throttle: float,
    torque: kernels.Vector,
    airmode: bool,
    loop: Loop,
    mix: Array,
    out: Array,
) -> tuple[float, float]:
    """Write the speeds (n,) [rad/s] for a throttle and a torque [N m]; return :func:`mixed`'s."""
    shares = mixed(
        thrust_at(throttle, kernels.vector(loop.thrust_curve)),
        torque=torque,
        mix=mix,
        limits=(loop.least, loop.greatest),
        airmode=airmode,
        out=out,
    )
    for rotor in range(out.shape[0]):
        out[rotor] = math.sqrt(out[rotor] / loop.thrust_coefficient)
    return shares


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
