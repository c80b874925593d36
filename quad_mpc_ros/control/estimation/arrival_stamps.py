# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Correction of odometry stamped on arrival: the displacement reveals the measurement time.

Between two odometries the vehicle moves by its velocity times the time between the measurements.
With the mean velocity v of both, the interval dt of the stamps and the lateness l of each stamp

    y = dt - v . dp / |v|^2 = l - l_before + noise,   of variance r / |v|^2.

True stamps give y = 0 for any intervals. Stamps of arrival have three signs: y along the track
varies far more than the deviation across it, the intervals vary as much, and the age of the
odometry by its stamp is constant. Then l is filtered as a deviation from the mean lateness, of
variance s^2 = var(y) / 2:

    K = s^2 / (s^2 + P + r / |v|^2),   l <- K (l + y - mean(y)),   P <- K (P + r / |v|^2).

The earliest arrival of the last seconds counts as arriving without delay. A delay common to all
arrivals is not observable; it belongs to ``input_delay``.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import kernels
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import Measured, OdometrySample
from quad_mpc_ros.control.stage import Stage

_STATISTICS_TIME = 2.0  # s, time constant of the sums
_MIN_SPEED = 0.3  # m/s: below it positions do not show the time
_MIN_JITTER = 0.003  # s, standard deviation from which on stamps are corrected
_MIN_VARIANCE_RATIO = 9.0  # variance along the track over that across it
_MIN_ODOMETRIES = 20.0
_LONGEST_GAP = 0.5  # s
_EARLIEST_TIME = 10.0  # s, time constant of the earliest arrival
# Intervals that differ by less are equal [s]; after so many equal ones stamps are not corrected.
_INTERVAL_TOLERANCE, _MIN_REGULAR = 0.001, 100
_MIN_STEP_NS = 1_000_000  # between corrected stamps


class _Sums:
    """Decaying sums; sums of y are weighted by the square of the speed."""

    def __init__(self) -> None:
        self._sums = np.zeros(9)
        self._first_age_ns: int | None = None

    def add(self, y: float, across: float, square: float, interval: float, age_ns: int) -> None:
        """Add one interval: y [s], squared deviation across the track [m^2], squared speed.

        ``interval`` is between the stamps [s], ``age_ns`` the age by the stamp; any clock offset.
        """
        if self._first_age_ns is None:
            self._first_age_ns = age_ns
        age = 1e-9 * (age_ns - self._first_age_ns)
        ages, ys = (age, age**2), (square * y, square * y**2)
        self._sums *= math.exp(-interval / _STATISTICS_TIME)
        self._sums += (1.0, interval, interval**2, *ages, across, square, *ys)

    def lateness(self) -> tuple[float, float, float] | None:
        """Return mean of y, variance of l and r; None if stamps are not arrival times."""
        count, interval, intervals, age, ages, across, square, y, ys = self._sums.tolist()
        if count < _MIN_ODOMETRIES:
            return None
        mean = y / square
        variance, noise = ys / square - mean**2, across / square
        irregular = intervals / count - (interval / count) ** 2
        aging = ages / count - (age / count) ** 2
        if (
            variance < max(_MIN_VARIANCE_RATIO * noise, _MIN_JITTER**2)
            or irregular < 0.3 * variance
            or aging > 0.1 * variance
        ):
            return None
        return mean, 0.5 * (variance - noise), across / count


class ArrivalStamps(Stage):
    """Corrects stamps of arrival; true stamps are unchanged."""

    def __init__(self) -> None:
        self._before: OdometrySample | None = None
        self._corrected_ns, self._interval = 0, 0.0  # of the previous odometry
        self._regular = 0  # successive equal intervals
        self._begin()

    def _begin(self) -> None:
        self._sums = _Sums()
        self._l = self._P = self._earliest = 0.0

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Drop the last odometry, whose coordinates are outdated."""
        self._before = None

    def corrected(self, odometry: OdometrySample, *, now_ns: int) -> OdometrySample:
        """Return the odometry, twist in the body frame, with the stamp of its measurement."""
        stamp_ns, before, last_ns = odometry.stamp_ns, self._before, self._corrected_ns
        interval = 0.0 if before is None else 1e-9 * (stamp_ns - before.stamp_ns)
        regular = -_INTERVAL_TOLERANCE < interval - self._interval < _INTERVAL_TOLERANCE
        self._before, self._corrected_ns, self._interval = odometry, stamp_ns, interval
        if before is None or not 0.0 < interval < _LONGEST_GAP:
            self._regular = 0
            self._begin()
            return odometry
        self._regular = self._regular + 1 if regular else 0
        if self._regular >= _MIN_REGULAR:  # not corrected until an interval differs
            if self._regular == _MIN_REGULAR:
                self._begin()
            return odometry
        late_ns = self._late_ns(before, odometry, interval, now_ns)
        if late_ns == 0:
            return odometry
        self._corrected_ns = min(max(stamp_ns - late_ns, last_ns + _MIN_STEP_NS), stamp_ns)
        return dataclasses.replace(odometry, stamp_ns=self._corrected_ns)

    def _late_ns(
        self, before: OdometrySample, after: OdometrySample, interval: float, now_ns: int
    ) -> int:
        """Return the lateness of the stamp; 0 for a true stamp."""
        y, across, square = _deviation(before.measured, after.measured, interval)
        if square > _MIN_SPEED**2 and -_LONGEST_GAP < y < _LONGEST_GAP:
            self._sums.add(y, across, square, interval, now_ns - after.stamp_ns)
        found = self._sums.lateness()
        if found is None:
            self._l = self._P = self._earliest = 0.0
            return 0
        mean, variance, r = found
        uncertain = self._P + r / max(square, 1e-12)
        K = variance / (variance + uncertain)
        self._l, self._P = K * (self._l + y - mean), K * uncertain
        # In hover K is near zero, so that the mean lateness does not change.
        self._earliest = min(self._earliest * math.exp(-K * interval / _EARLIEST_TIME), self._l)
        return round(1e9 * (self._l - self._earliest))


@compiled
def _deviation(before: Measured, after: Measured, interval: float) -> tuple[float, float, float]:
    """Return y [s], squared deviation across the track [m^2] and squared speed."""
    (p_before, q_before, v_before, _), (p_after, q_after, v_after, _) = before, after
    moved_W = kernels.minus(kernels.vector(p_after), kernels.vector(p_before))
    v_W = kernels.in_world(q_before, v_before)
    mean_W = kernels.scaled(0.5, kernels.plus(v_W, kernels.in_world(q_after, v_after)))
    square = kernels.dot(mean_W, mean_W)
    y = interval - kernels.dot(mean_W, moved_W) / max(square, 1e-12)
    off_W = kernels.minus(moved_W, kernels.scaled(interval, mean_W))
    return y, 0.5 * max(kernels.dot(off_W, off_W) - square * (y * y), 0.0), square
