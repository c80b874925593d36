"""When a landing vehicle stands, and when it only seems to."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.references.touchdown import Touchdown

SPEED = 0.3
RNG = np.random.default_rng(1)


def felt_at(
    heights: np.ndarray,
    speeds: np.ndarray,
    *,
    rate: float = 50.0,
    noise: tuple[float, float] = (0.0, 0.0),
    reference: np.ndarray | None = None,
) -> float | None:
    """Return when a touchdown is felt [s]; the reference sinks from 0 unless given."""
    touchdown = Touchdown(SPEED)
    for k, (height, speed) in enumerate(zip(heights, speeds, strict=True)):
        time = k / rate
        odometry = OdometrySample(
            stamp_ns=round(1e9 * time),
            p_WB=np.array([0.0, 0.0, height + noise[0] * RNG.standard_normal()]),
            q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
            v_WB_B=np.array([0.0, 0.0, speed]) + noise[1] * RNG.standard_normal(3),
            w_WB_B=np.zeros(3),
        )
        below = -SPEED * time if reference is None else reference[k]
        if touchdown.felt(odometry, reference_height=below):
            return time
    return None


@pytest.mark.parametrize("rate", [15.0, 50.0, 400.0])
@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.03, 0.1)])
def test_detects_standing_soon(rate: float, noise: tuple[float, float]) -> None:
    still = np.zeros(round(4.0 * rate))
    time = felt_at(still, still, rate=rate, noise=noise)
    assert time is not None
    assert 0.15 / SPEED + 0.5 <= time <= 2.5


def test_half_a_second_settles_it() -> None:
    still = np.zeros(100)
    assert felt_at(still, still) == pytest.approx(0.15 / SPEED + 0.5, abs=0.1)


@pytest.mark.parametrize(("share", "stands"), [(0.35, True), (0.75, False)])
def test_what_moves_at_less_than_half_the_touchdown_speed_stands(
    share: float, stands: bool
) -> None:
    """As on a deck, or by an estimate that drifts."""
    times = np.arange(0.0, 8.0, 0.02)
    climbs = share * SPEED * times
    assert (felt_at(climbs, np.full(len(times), share * SPEED)) is not None) is stands


def test_sinking_behind_the_reference_is_not_standing() -> None:
    times = np.arange(0.0, 10.0, 0.02)
    behind = 0.5 - SPEED * times
    assert felt_at(behind, np.full(len(times), -SPEED)) is None
    # Odometry without a twist, and odometry whose height has stuck.
    assert felt_at(behind, np.zeros(len(times))) is None
    assert felt_at(np.zeros(len(times)), np.full(len(times), -SPEED)) is None


def test_hovering_on_the_reference_is_not_standing() -> None:
    still = np.zeros(500)
    assert felt_at(still, still, reference=still - 0.1) is None


def test_nan_is_not_standing() -> None:
    none = np.full(300, np.nan)
    assert felt_at(none, none * 0.0) is None
