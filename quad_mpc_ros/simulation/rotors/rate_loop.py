"""The rate loop of an autopilot: from throttle, wanted rates and gyro to speeds of the rotors.

For each axis, with the error e = w_wanted - w of the filtered gyro w,

    alpha = P e + I int e + F w_wanted - D dw/dt

with D on the gyro alone, filtered once more; the torque asked for is alpha times the diagonal of
the inertia. The integral has a limit and stands still while its torque saturates in its
direction. On the ground it is empty and there is no airmode, which could lift off.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors import filters
from quad_mpc_ros.simulation.rotors.mixer import mixed
from quad_mpc_ros.simulation.rotors.parameters import RotorsPlantParameters

# The memory of the loop: a row for each axis, of these parts.
_INTEGRAL, _GYRO, _BEFORE, _SLOPE = 0, slice(1, 3), 3, 4
MEMORY_SHAPE = (3, 5)


class Loop(NamedTuple):
    """The numbers of a rate loop: the parameters of these names, and what follows from them.

    ``inertia`` is the diagonal [kg m^2], ``thrust_curve`` that of all rotors together [N] at a
    throttle, ``least`` and ``greatest`` the thrusts of a rotor [N], ``period`` [s].
    """

    period: float
    p: kernels.Vector
    i: kernels.Vector
    d: kernels.Vector
    feed_forward: kernels.Vector
    integral_max: kernels.Vector
    torque_max: kernels.Vector
    inertia: kernels.Vector
    gyro: filters.Section
    smoothing: float
    airmode: bool
    thrust_curve: kernels.Vector
    thrust_coefficient: float
    least: float
    greatest: float


def loop_vector(config: RotorsPlantParameters) -> Array:
    """Return a configured rate loop as compiled code takes it.

    It knows the rotors as they are meant to be, not how strong they truly are.
    """
    loop, rotors = config.rate_loop, config.rotors
    (b0, b1, b2), (a1, a2) = filters.butterworth(loop.gyro_cutoff, loop.rate)
    return np.array(
        [
            1.0 / loop.rate,
            *loop.p,
            *loop.i,
            *loop.d,
            *loop.feed_forward,
            *loop.integral_max,
            *loop.torque_max,
            *config.airframe.inertia[0:3],
            *(b0, b1, b2, a1, a2),
            filters.smoothing(loop.d_cutoff, loop.rate),
            float(loop.airmode),
            *(config.motor_count * coefficient for coefficient in config.thrust_curve),
            rotors.thrust_coefficient,
            rotors.thrust_coefficient * rotors.speed_min**2,
            rotors.thrust_coefficient * rotors.speed_max**2,
        ]
    )


@compiled
def loop_in(vector: Array) -> Loop:
    """Return what is in the vector (35,)."""
    return Loop(
        vector[0],
        kernels.vector(vector[1:4]),
        kernels.vector(vector[4:7]),
        kernels.vector(vector[7:10]),
        kernels.vector(vector[10:13]),
        kernels.vector(vector[13:16]),
        kernels.vector(vector[16:19]),
        kernels.vector(vector[19:22]),
        (kernels.vector(vector[22:25]), (vector[25], vector[26])),
        vector[27],
        vector[28] != 0.0,
        kernels.vector(vector[29:32]),
        vector[32],
        vector[33],
        vector[34],
    )


@compiled
def begin(memory: Array, w_WB_B: Array, loop: Array) -> None:
    """Let the loop's memory (3, 5) begin at rates (3,) [rad/s] that have lasted."""
    numbers = loop_in(loop)
    memory[:] = 0.0
    for axis in range(3):
        filters.settle(w_WB_B[axis], section=numbers.gyro, held=memory[axis, 1:3])
        memory[axis, _BEFORE] = w_WB_B[axis]


@compiled
def run(
    memory: Array, w_WB_B: Array, command: Array, stands: bool, loop: Array, mix: Array, out: Array
) -> None:
    """Run the loop once: write the wanted speeds of the rotors (n,) [rad/s] into ``out``.

    ``memory`` is (3, 5), ``w_WB_B`` (3,) the gyro, ``command`` (4,) throttle and rates.
    """
    numbers = loop_in(loop)
    error, wanted = np.empty(3), np.empty(3)
    for axis in range(3):
        own = memory[axis]
        rate = _measured(own, w_WB_B[axis], numbers)
        error[axis] = command[1 + axis] - rate
        alpha = numbers.p[axis] * error[axis] + own[_INTEGRAL] - numbers.d[axis] * own[_SLOPE]
        alpha += numbers.feed_forward[axis] * command[1 + axis]
        wanted[axis] = numbers.inertia[axis] * alpha
    asked = _limited(wanted, numbers.torque_max)
    airmode = numbers.airmode and not stands
    turn, yaw = speeds(command[0], asked, airmode=airmode, loop=loop, mix=mix, out=out)
    for axis in range(3):
        share = turn if axis < 2 else yaw
        saturated = share < 1.0 or asked[axis] != wanted[axis]
        if stands:
            memory[axis, _INTEGRAL] = 0.0
        elif not (saturated and error[axis] * wanted[axis] > 0.0):
            step = numbers.period * numbers.i[axis] * error[axis]
            most = numbers.integral_max[axis]
            memory[axis, _INTEGRAL] = kernels.clamp(memory[axis, _INTEGRAL] + step, -most, most)


@compiled
def _measured(own: Array, gyro: float, loop: Loop) -> float:
    """Return the filtered rate of an axis [rad/s]; renew its filtered slope [rad/s^2]."""
    rate = filters.filtered(gyro, section=loop.gyro, held=own[_GYRO])
    slope = (rate - own[_BEFORE]) / loop.period
    own[_BEFORE] = rate
    own[_SLOPE] += loop.smoothing * (slope - own[_SLOPE])
    return rate


@compiled
def _limited(torque: Array, most: kernels.Vector) -> kernels.Vector:
    return (
        kernels.clamp(torque[0], -most[0], most[0]),
        kernels.clamp(torque[1], -most[1], most[1]),
        kernels.clamp(torque[2], -most[2], most[2]),
    )


@compiled
def speeds(
    throttle: float, torque: kernels.Vector, airmode: bool, loop: Array, mix: Array, out: Array
) -> tuple[float, float]:
    """Write the speeds (n,) [rad/s] for a throttle and a torque [N m]; return :func:`mixed`'s."""
    numbers = loop_in(loop)
    a, b, c = numbers.thrust_curve
    shares = mixed(
        (a * throttle + b) * throttle + c,
        torque=torque,
        mix=mix,
        limits=(numbers.least, numbers.greatest),
        airmode=airmode,
        out=out,
    )
    for rotor in range(out.shape[0]):
        out[rotor] = math.sqrt(out[rotor] / numbers.thrust_coefficient)
    return shares
