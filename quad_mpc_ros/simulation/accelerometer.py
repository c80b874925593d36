"""An accelerometer at the origin of the body, for any plant.

A sample is the mean acceleration since the previous measurement, minus gravity, in the midpoint
body frame. The measurement is independent of the plant's equations and includes ground contact.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.parameters import Stream, white_noise
from quad_mpc_ros.simulation.plant import Plant

_SECOND = 1_000_000_000


class Accelerometer:
    """Measures a plant between its odometries, if configured, and buffers the samples."""

    def __init__(self, plant: Plant, config: SimulatorConfig, *, stamp_offset_ns: int) -> None:
        """``stamp_offset_ns`` is the stamp minus the time of the plant."""
        self._plant, self._stamp_offset_ns = plant, stamp_offset_ns
        self._per_odometry = math.ceil(config.imu_rate / config.odom_rate - 1e-9)
        self._noise, self._bias = config.imu_noise, np.array(config.imu_bias)
        self._gravity_W = np.array([0.0, 0.0, -config.gravity])
        self._white_noise = white_noise(config.random(Stream.IMU), 3)
        self._frame_id = config.child_frame_id
        self._before: OdometrySample | None = None
        self._due_ns: list[int] = []
        self._measured: list[ImuSample] = []

    def plan(self, from_ns: int, to_ns: int) -> None:
        """Schedule regular measurements from one odometry up to the next."""
        if self._per_odometry == 0:
            return
        if self._before is None:
            self._before = self._plant.odometry(from_ns)
        count = self._per_odometry
        self._due_ns = [from_ns + (k + 1) * (to_ns - from_ns) // count for k in range(count)]

    def advance_to(self, time_ns: int) -> None:
        """Advance the plant to a time, and measure in between."""
        while self._due_ns and self._due_ns[0] <= time_ns:
            due_ns = self._due_ns.pop(0)
            self._plant.advance_to(due_ns)
            self._measure(self._plant.odometry(due_ns))
        self._plant.advance_to(time_ns)

    def take(self) -> tuple[ImuSample, ...]:
        """Return the samples since the last call."""
        measured, self._measured = tuple(self._measured), []
        return measured

    def _measure(self, now: OdometrySample) -> None:
        before, self._before = self._before, now
        assert before is not None
        seconds = (now.stamp_ns - before.stamp_ns) / _SECOND
        R_before, R_now = (so3.rotation_from_quaternion_xyzw(x.q_WB_xyzw) for x in (before, now))
        R_WB = R_before @ so3.exp(0.5 * so3.log(R_before.T @ R_now))
        change_W = R_now @ now.v_WB_B - R_before @ before.v_WB_B
        f_B = R_WB.T @ (change_W / seconds - self._gravity_W)
        error = self._bias + self._noise * next(self._white_noise)
        stamp_ns = now.stamp_ns + self._stamp_offset_ns
        self._measured.append(
            ImuSample(stamp_ns=stamp_ns, f_B=f_B + error, frame_id=self._frame_id)
        )
