"""Records of the plants: inputs, numbers of a vehicle, and the measured motion."""

from __future__ import annotations

from quad_mpc_ros.configuration.records import Record, Vector3, Vector4


class PlantInputs(Record):
    """Constant inputs of a vehicle."""

    throttle: float  # 0 to 1
    w_WB_B: Vector3  # commanded body rates [rad/s]
    wind_W: Vector3  # velocity of the air [m/s]


class VehicleConstants(Record):
    """The numbers of the plant ``internal``."""

    is_rigid_body: int  # 0 for the paper's Eq. (3)
    gravity: float  # m/s^2
    lift: Vector3  # thrust over mass, a polynomial of the throttle, highest power first [m/s^2]
    thrust_time_constant: float  # s
    thrust_time_constant_down: float  # s, while the throttle decreases
    rate_time_constant: Vector3  # s
    torque_time_constant: Vector3  # s
    angular_acceleration_max: Vector3  # rad/s^2
    drag: Vector3  # 1/s
    rotor_drag: Vector3  # 1/s
    translational_lift: float  # 1/m


class Measured(Record):
    """The true motion of the body's origin, as an odometry reports it."""

    p_WB: Vector3  # m
    q_WB_xyzw: Vector4
    v_WB_B: Vector3  # m/s
    w_WB_B: Vector3  # rad/s
