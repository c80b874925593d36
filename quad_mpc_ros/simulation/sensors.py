# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry measurements: noise, bias, drift, losses and delay; and an accelerometer."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import ImuSample, OdometrySample
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.parameters import Stream, white_noise
from quad_mpc_ros.simulation.plant import Plant, Powered

_MAX_JITTER = 0.45  # periods; below one half, so that odometries stay in order

_DRIFT_TIME = 1.0  # s, correlation time of the velocity drift
_VOLTAGE_PERIOD_NS = 200_000_000  # of the battery's voltage


class Sensors:
    """Adds white noise, biases and drift to the odometry, and selects lost odometries.

    Errors of the position are in the world, errors of velocity, body rates and attitude in the
    body. The attitude is R exp(bias + noise), so that the quaternion keeps unit length. The drift
    of the velocity, in the world, is a first-order Gauss-Markov process, sampled exactly.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self._noise = np.repeat(
            [
                config.position_noise,
                config.attitude_noise,
                config.velocity_noise,
                config.rate_noise,
            ],
            3,
        )
        self._bias = np.concatenate(
            (config.position_bias, config.attitude_bias, config.velocity_bias, np.zeros(3))
        )
        self._velocity_drift = config.velocity_drift
        self._drift_noise = white_noise(config.random(Stream.DRIFT), 3)
        self._drift_stamp_ns: int | None = None
        self._drift_W = np.zeros(3)
        self._exact = not (self._noise.any() or self._bias.any() or config.velocity_drift > 0.0)
        self._dropout = config.odom_dropout
        self._white_noise = white_noise(config.random(Stream.NOISE), self._noise.size)
        self._dropout_random = config.random(Stream.DROPOUT)
        self._first = True

    def measured(self, truth: OdometrySample) -> OdometrySample:
        """Return the measurement of a true odometry."""
        if self._exact:
            return truth
        errors = self._bias + self._noise * next(self._white_noise)
        of_p, of_R, of_v, of_w = errors.reshape(-1, 3)
        R_true = so3.rotation_from_quaternion_xyzw(truth.q_WB_xyzw)
        R_WB = R_true @ so3.exp(of_R)
        of_v = of_v + R_true.T @ self._drift_at(truth.stamp_ns)
        return OdometrySample(
            stamp_ns=truth.stamp_ns,
            p_WB=truth.p_WB + of_p,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_WB),
            v_WB_B=truth.v_WB_B + of_v,
            w_WB_B=truth.w_WB_B + of_w,
            frame_id=truth.frame_id,
            child_frame_id=truth.child_frame_id,
        )

    def lost(self) -> bool:
        """Whether the next odometry is lost; never the first, which starts the reference."""
        first, self._first = self._first, False
        drawn = self._dropout > 0.0 and self._dropout_random.random() < self._dropout
        return bool(drawn and not first)

    def _drift_at(self, stamp_ns: int) -> Array:
        """Return the drift (3,) [m/s] in the world at a time not before the previous time."""
        if self._velocity_drift > 0.0:
            before_ns, self._drift_stamp_ns = self._drift_stamp_ns, stamp_ns
            kept = 0.0
            if before_ns is not None:
                kept = math.exp(-1e-9 * (stamp_ns - before_ns) / _DRIFT_TIME)
            fresh = self._velocity_drift * math.sqrt(1.0 - kept**2) * next(self._drift_noise)
            self._drift_W = kept * self._drift_W + fresh
        return self._drift_W


def odometry_stamps(config: SimulatorConfig) -> Iterator[int]:
    """Yield the times of the measurements from the start [ns], for the configured duration.

    Each time is computed from its number, so that rounding does not accumulate. Jitter is
    independent; the first measurement has none.
    """
    random = config.random(Stream.JITTER)
    jitter = config.odom_jitter * config.odom_rate
    count = round(config.duration * config.odom_rate) if config.duration > 0.0 else None
    for number in itertools.islice(itertools.count(), count):
        late = 0.0
        if jitter > 0.0 and number > 0:
            drawn = jitter * random.standard_normal()
            late = min(max(drawn, -_MAX_JITTER), _MAX_JITTER)
        yield round((number + late) * 1e9 / config.odom_rate)


def stamp_offset_ns(config: SimulatorConfig) -> int:
    """Return the time from an odometry's measurement to its stamp [ns]."""
    return round(config.odom_delay * 1e9) if config.odom_stamp == "sent" else 0


@dataclass(frozen=True, kw_only=True, eq=False)
class SentOdometry:
    """An odometry and its sending time since the start of the plant; ``truth`` is without error.

    If stamps are times of publication, :meth:`OdometryStream.step` returns the truth at that time.
    ``voltage`` [V] is the battery's, measured with some of the odometries. ``imu`` are the samples
    of the accelerometer since the previous published odometry, the last sample at the time of this
    odometry; samples are published before the odometry.
    """

    time_ns: int
    odometry: OdometrySample
    truth: OdometrySample
    voltage: float | None = None
    imu: tuple[ImuSample, ...] = ()


class Accelerometer:
    """An accelerometer at the origin of the body, for any plant, if configured.

    A sample is the mean acceleration since the previous measurement, minus gravity, in the
    midpoint body frame. The measurement is independent of the plant's equations and includes
    ground contact.
    """

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
        seconds = (now.stamp_ns - before.stamp_ns) / 1_000_000_000
        R_before, R_now = (so3.rotation_from_quaternion_xyzw(x.q_WB_xyzw) for x in (before, now))
        R_WB = R_before @ so3.exp(0.5 * so3.log(R_before.T @ R_now))
        change_W = R_now @ now.v_WB_B - R_before @ before.v_WB_B
        f_B = R_WB.T @ (change_W / seconds - self._gravity_W)
        error = self._bias + self._noise * next(self._white_noise)
        stamp_ns = now.stamp_ns + self._stamp_offset_ns
        self._measured.append(
            ImuSample(stamp_ns=stamp_ns, f_B=f_B + error, frame_id=self._frame_id)
        )


class OdometryStream:
    """Advances the plant and measures its state.

    A measurement at the arrival of a command does not include the command. Lost odometries are
    measured but not published.
    """

    def __init__(self, plant: Plant, config: SimulatorConfig, *, start_stamp_ns: int) -> None:
        self._plant = plant
        self._sensors = Sensors(config)
        self._start_stamp_ns = start_stamp_ns
        self._delay_ns = round(config.odom_delay * 1e9)
        self._stamp_offset_ns = stamp_offset_ns(config)
        self._accelerometer = Accelerometer(
            plant, config, stamp_offset_ns=start_stamp_ns + self._stamp_offset_ns
        )
        self._period_ns = round(1e9 / config.odom_rate)
        self._times = odometry_stamps(config)
        self._next_ns = next(self._times, None)
        self._waiting: deque[SentOdometry] = deque()
        self._end_ns = 0
        self._powered = plant if isinstance(plant, Powered) else None
        self._voltage_due_ns = 0

    def step(self) -> SentOdometry | None:
        """Advance the plant to the next publication; None at the end of the flight."""
        while not self._waiting or self._measures_by(self._waiting[0].time_ns):
            if self._next_ns is None:
                return None
            self._measure()
        sent = self._waiting.popleft()
        self._accelerometer.advance_to(sent.time_ns)
        if self._stamp_offset_ns:
            return dataclasses.replace(sent, truth=self._plant.odometry(sent.odometry.stamp_ns))
        return sent

    def advance_to(self, time_ns: int) -> list[SentOdometry]:
        """Advance the plant to a time and return the odometries due by then."""
        while self._measures_by(time_ns):
            self._measure()
        self._accelerometer.advance_to(time_ns)
        due = []
        while self._waiting and self._waiting[0].time_ns <= time_ns:
            due.append(self._waiting.popleft())
        return due

    def ended(self, time_ns: int) -> bool:
        """Whether the last odometry was published at least a period ago."""
        return self._next_ns is None and not self._waiting and time_ns >= self._end_ns

    def _measures_by(self, time_ns: int) -> bool:
        return self._next_ns is not None and self._next_ns <= time_ns

    def _measure(self) -> None:
        assert self._next_ns is not None
        self._accelerometer.advance_to(self._next_ns)
        stamp_ns = self._start_stamp_ns + self._next_ns + self._stamp_offset_ns
        truth = self._plant.odometry(stamp_ns)
        odometry = self._sensors.measured(truth)
        time_ns = self._next_ns + self._delay_ns
        if not self._sensors.lost():
            voltage = self._voltage(self._next_ns)
            sent = SentOdometry(
                time_ns=time_ns,
                odometry=odometry,
                truth=truth,
                voltage=voltage,
                imu=self._accelerometer.take(),
            )
            self._waiting.append(sent)
        self._end_ns = time_ns + self._period_ns
        measured_ns, self._next_ns = self._next_ns, next(self._times, None)
        if self._next_ns is not None:
            self._accelerometer.plan(measured_ns, self._next_ns)

    def _voltage(self, time_ns: int) -> float | None:
        """Return the battery's voltage [V] if there is a battery and a measurement is due."""
        if self._powered is None or time_ns < self._voltage_due_ns:
            return None
        self._voltage_due_ns = time_ns + _VOLTAGE_PERIOD_NS
        return self._powered.battery_voltage
