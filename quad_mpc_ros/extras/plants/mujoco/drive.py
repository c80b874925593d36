# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The force and torque of rotors and air on the body over a step, for MuJoCo, compiled.

MuJoCo simulates weight, inertia and contacts. The remaining force and torque are the means over a
Runge-Kutta step of order 4 of the plant ``rotors`` in free flight. Both plants therefore have the
same accelerations in the air.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.simulation.rotors.craft import BodyState, Craft, Rotor
from quad_mpc_ros.simulation.rotors.motion import RotorInputs, runge_kutta

_BODY_DTYPE = BodyState.dtype
_Z_AXIS = 2


class Drive(Record):
    """Force and torque on the body in addition to its weight, constant over a step."""

    force_W: Vector3  # at the centre of mass [N]
    torque_B: Vector3  # about the centre of mass [N m]


@compiled
def drive(
    body: RecordArray[BodyState],
    speeds: Array,
    wanted: Array,
    inputs: RecordArray[RotorInputs],
    craft: RecordArray[Craft],
    rotors: RecordArray[Rotor],
    ground: float,
    duration: float,
    out: RecordArray[Drive],
) -> None:
    """Advance speeds (n,) and battery over a step [s]; write force and torque on the body.

    ``ground`` is the height of the origin of a vehicle that stands on the surface below [m], the
    reference height of the ground effect.
    """
    before = np.empty((), _BODY_DTYPE)
    before[()] = body[()]
    x, numbers, acts = body[()], craft[()], out[()]
    v, w = kernels.vector(x.v_WC_W), kernels.vector(x.w_WB_B)
    x.p_WC[_Z_AXIS] -= ground
    outside = kernels.vector(inputs[()].wind_W), kernels.vector(inputs[()].external_force_W)
    runge_kutta(body, speeds, wanted, outside, craft=craft, rotors=rotors, duration=duration)
    a = _mean_rate(v, kernels.vector(x.v_WC_W), duration)
    alpha = _mean_rate(w, kernels.vector(x.w_WB_B), duration)
    used = x.charge_used
    body[()] = before[()]
    x.charge_used = used
    lifted = (a[0], a[1], a[_Z_AXIS] + numbers.gravity)
    kernels.store_vector(kernels.scaled(numbers.mass, lifted), acts.force_W)
    # MuJoCo adds -w x J w itself over the step; its mean is the value in the middle.
    w = kernels.plus(w, kernels.scaled(0.5 * duration, alpha))
    inertia = kernels.matrix(numbers.inertia)
    torque = kernels.plus(
        kernels.apply(inertia, alpha), kernels.cross(w, kernels.apply(inertia, w))
    )
    kernels.store_vector(torque, acts.torque_B)


@compiled
def _mean_rate(before: kernels.Vector, after: kernels.Vector, duration: float) -> kernels.Vector:
    return kernels.scaled(1.0 / duration, kernels.minus(after, before))
