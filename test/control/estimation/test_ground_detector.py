# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Landing detection: no false detection in the air."""

from __future__ import annotations

import numpy as np
import pytest
from fixtures.windows import window_through
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import (
    AllowedCommand,
    GroundState,
    idles,
    idling,
)
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

MS = 1_000_000
PERIOD = 0.02  # s
BELOW = ReferenceWindow.hover([0.0, 0.0, -0.5])
ABOVE = ReferenceWindow.hover([0.0, 0.0, 1.0])


class Detector:
    """A ground detector with an odometry every 20 ms."""

    def __init__(self) -> None:
        self.ground = GroundDetector()
        self._stamp_ns = 0

    def observe(
        self,
        seconds: float = PERIOD,
        *,
        thrust: float = 0.0,
        height: float = 0.0,
        velocity: Array | None = None,
        window: ReferenceWindow | None = BELOW,
    ) -> list[GroundState]:
        """Return the states while nothing changes."""
        states = []
        for _ in range(round(seconds / PERIOD)):
            odometry = OdometrySample(
                stamp_ns=self._stamp_ns,
                p_WB=np.array([0.0, 0.0, height]),
                q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
                v_WB_B=np.zeros(3) if velocity is None else velocity,
                w_WB_B=np.zeros(3),
            )
            states.append(self.ground.update(odometry, thrust=thrust, window=window))
            self._stamp_ns += 20 * MS
        return states

    def wait(self, seconds: float) -> None:
        """Send no odometry for a while."""
        self._stamp_ns += round(1e9 * seconds)


@pytest.fixture
def detector() -> Detector:
    return Detector()


@pytest.fixture
def grounded(detector: Detector) -> Detector:
    detector.observe(2.0)
    assert detector.ground.state.is_on_ground
    return detector


def test_detects_the_ground_at_rest_without_thrust(detector: Detector) -> None:
    states = detector.observe(3.0)
    since = states.index(GroundState.ON_GROUND) * PERIOD
    assert 0.5 < since < 0.7
    assert set(states[states.index(GroundState.ON_GROUND) :]) == {GroundState.ON_GROUND}


def test_estimates_in_hover_after_spool_up(detector: Detector) -> None:
    states = detector.observe(3.0, thrust=1.0, height=2.0)
    assert 1.5 < states.index(GroundState.FLYING) * PERIOD < 2.0
    assert detector.ground.state.is_flying


def test_drift_is_not_lift_off(grounded: Detector) -> None:
    """PX4's estimate climbs by 0.1 m/s on the ground; motors spool up half a second."""
    states, height = [], 0.0
    for k in range(300):
        height += 0.12 * PERIOD
        thrust = 0.0 if k < 275 else 0.6
        states += grounded.observe(thrust=thrust, height=height, window=ABOVE)
    assert set(states) == {GroundState.LIFTING_OFF}
    assert (
        grounded.observe(1.0, thrust=1.1, height=height + 0.3, window=ABOVE)[-1]
        is GroundState.FLYING
    )


def test_negative_thrust_curve_counts_as_no_thrust(detector: Detector) -> None:
    assert detector.observe(2.0, thrust=-0.05)[-1] is GroundState.ON_GROUND


def test_a_vehicle_that_leaves_its_position_is_flying(detector: Detector) -> None:
    detector.observe(0.2, thrust=0.7, height=2.0)
    states = detector.observe(0.4, thrust=0.7, height=1.8)
    assert states[-1] is GroundState.FLYING


def test_little_thrust_pauses_learning(detector: Detector) -> None:
    detector.observe(3.0, thrust=1.0, height=2.0)
    detector.observe(thrust=0.2, height=2.0)
    assert detector.ground.state.is_flying
    assert detector.ground.learning is UpdateMode.VELOCITY_ONLY


def test_landing_pauses_learning_below_half_a_metre(grounded: Detector) -> None:
    grounded.observe(1.0, thrust=1.1, height=2.0, window=ABOVE)
    down = window_through([0.0, 1.0, 2.0], [[0, 0, 0.3], [0, 0, 0.0], [0, 0, -0.3]])
    for height, window, might in [
        (1.0, down, False),
        (0.3, down, True),
        (0.25, down, True),
        (0.3, ReferenceWindow.hover([0.0, 0.0, 0.3]), False),
        (0.3, ABOVE, False),
    ]:
        grounded.observe(thrust=1.0, height=height, window=window)
        assert grounded.ground.state.is_flying
        assert (grounded.ground.learning is UpdateMode.VELOCITY_ONLY) is might


def test_stays_on_the_ground_until_the_height_rises(grounded: Detector) -> None:
    assert set(grounded.observe(1.0, thrust=0.9, window=ABOVE)) == {GroundState.LIFTING_OFF}
    assert grounded.ground.allowed is AllowedCommand.LEVEL
    states = [grounded.observe(thrust=1.1, height=0.01 * k, window=ABOVE)[0] for k in range(60)]
    assert states[0] is GroundState.LIFTING_OFF
    assert 0.1 < 0.01 * states.index(GroundState.FLYING) < 0.3


def test_detects_take_off_after_height_drifted_down(grounded: Detector) -> None:
    """PX4's height drifts by 0.2 m during spool-up; then the vehicle climbs with 0.5 m/s^2."""
    for k in range(50):
        grounded.observe(thrust=0.01 * k + 0.45, height=-0.004 * k, window=ABOVE)
    times = PERIOD * np.arange(80)
    states = [
        grounded.observe(
            thrust=1.05,
            height=-0.2 + 0.25 * time**2,
            velocity=np.array([0.0, 0.0, 0.5 * time]),
            window=ABOVE,
        )[0]
        for time in times
    ]
    lifted = 0.25 * times[states.index(GroundState.FLYING)] ** 2
    assert 0.05 < lifted < 0.15


def test_noisy_velocity_is_not_lift_off(grounded: Detector) -> None:
    noise = np.random.default_rng(7)
    for _ in range(500):
        velocity = 0.3 * noise.normal(size=3)
        height = 0.01 * float(noise.normal())
        states = grounded.observe(thrust=0.9, height=height, velocity=velocity, window=ABOVE)
        assert states == [GroundState.LIFTING_OFF]


def test_detects_sideways_take_off_from_slope(grounded: Detector) -> None:
    """Leaning by 13 degrees it goes aside by 2 m/s^2 as soon as its thrust carries it."""
    states = []
    for k in range(50):
        velocity = np.array([2.0 * PERIOD * k, 0.0, 0.0])
        states += grounded.observe(thrust=1.0, velocity=velocity, window=ABOVE)
    assert 0.25 < states.index(GroundState.FLYING) * PERIOD < 0.45


def test_push_while_idling_is_not_a_lift_off(grounded: Detector) -> None:
    pushed = np.array([0.9, 0.0, 0.0])
    assert set(grounded.observe(1.0, thrust=0.0, velocity=pushed)) == {GroundState.ON_GROUND}


def test_reference_slightly_above_does_not_command_a_climb(grounded: Detector) -> None:
    above = ReferenceWindow.hover([0.0, 0.0, 0.08])
    assert set(grounded.observe(1.0, window=above)) == {GroundState.ON_GROUND}


def test_estimates_after_lift_off(grounded: Detector) -> None:
    grounded.observe(0.5, thrust=1.1, window=ABOVE)
    learning = []
    for k in range(100):
        grounded.observe(thrust=1.1, height=0.02 * k, window=ABOVE)
        learning.append(grounded.ground.learning)
    left = 8  # 0.16 m
    assert set(learning) == {UpdateMode.HOLD, UpdateMode.LEARN}
    assert 0.6 < PERIOD * (learning.index(UpdateMode.LEARN) - left) < 1.0


IDLE = idling(ReferenceWindow.hover([0.0, 0.0, 0.0]), 9.81)


def test_recognises_a_reference_that_requests_idle_motors() -> None:
    assert idles(IDLE, 9.81) and idles(IDLE, 9.80665)
    assert not idles(ABOVE, 9.81)
    falling = window_through([0.0, 0.5, 1.0], [[0, 0, 9], [0, 0, 8], [0, 0, 5.1]])
    assert not idles(falling, 9.81)


def test_idles_on_request_in_the_unknown_state(detector: Detector) -> None:
    detector.ground.idle_wanted = True
    assert detector.ground.allowed is AllowedCommand.IDLE
    assert detector.observe(1.0, window=IDLE)[-1] is GroundState.ON_GROUND
    assert set(detector.observe(5.0, height=-0.5, window=IDLE)) == {GroundState.ON_GROUND}


@pytest.mark.parametrize("height", [0.0, 50.0])
def test_idling_in_the_air_ends_when_the_vehicle_falls(detector: Detector, height: float) -> None:
    """Requested idling in the air ends after 0.3 s, less than half a metre of fall."""
    detector.observe(
        2.0, thrust=1.0, height=height, window=ReferenceWindow.hover([0.0, 0.0, height])
    )
    detector.ground.idle_wanted, speed, start = True, 0.0, height
    states = []
    while height > start - 0.5:
        idle = detector.ground.allowed is AllowedCommand.IDLE
        speed -= 9.81 * PERIOD * idle
        height += speed * PERIOD
        velocity = np.array([0.0, 0.0, speed])
        states += detector.observe(
            thrust=0.0 if idle else 1.0, height=height, velocity=velocity, window=IDLE
        )
    assert GroundState.TOUCHING_DOWN in states
    assert states[-1] is GroundState.FLYING
    assert GroundState.ON_GROUND not in states


def test_a_fall_ends_the_ground_state(grounded: Detector) -> None:
    """A false landing ends within 0.3 s."""
    speeds = -9.81 * PERIOD * np.arange(60)
    heights = np.cumsum(speeds) * PERIOD
    states = [
        grounded.observe(height=float(height), velocity=np.array([0.0, 0.0, speed]))[0]
        for height, speed in zip(heights, speeds, strict=True)
    ]
    assert states.index(GroundState.FLYING) * PERIOD <= 0.3


def test_levels_after_touchdown_at_the_take_off_place(grounded: Detector) -> None:
    grounded.observe(1.0, thrust=1.1, height=1.0, window=ABOVE)
    assert grounded.ground.state is GroundState.FLYING
    for height, thrust, touching in [
        (1.0, 0.3, False),
        (0.2, 1.0, False),
        (0.2, 0.3, True),
    ]:
        grounded.observe(0.1, thrust=thrust, height=height)
        assert (grounded.ground.state is GroundState.TOUCHING_DOWN) is touching
    grounded.observe(height=0.2, window=ABOVE)
    assert grounded.ground.state is not GroundState.TOUCHING_DOWN
    grounded.observe(height=0.2, velocity=np.array([0.0, 0.0, -20.0]))
    assert grounded.ground.state is not GroundState.TOUCHING_DOWN


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_levels_on_ground_contact_with_reduced_thrust(grounded: Detector, carrying: float) -> None:
    """Any share of the weight by the model may carry the vehicle."""
    down = land(grounded, carrying)
    for _ in range(20):
        grounded.observe(thrust=0.65 * carrying, height=0.2, window=down)
    assert grounded.ground.state is GroundState.TOUCHING_DOWN
    assert not grounded.ground.state.is_on_ground


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_permits_body_rates_when_falling_with_reduced_thrust(
    grounded: Detector, carrying: float
) -> None:
    down, height, speed, share = land(grounded, carrying), 0.3, -0.3, 0.65
    for _ in range(20):
        speed -= 9.81 * (1.0 - share) * PERIOD
        height += speed * PERIOD
        velocity = np.array([0.0, 0.0, speed])
        grounded.observe(thrust=share * carrying, height=height, velocity=velocity, window=down)
        assert grounded.ground.state is not GroundState.TOUCHING_DOWN


@pytest.mark.parametrize(
    ("height", "stop", "thrust", "touches"),
    [(0.3, 0.0, 1.0, True), (0.8, 0.0, 1.0, False), (0.3, 0.16, 1.2, False)],
    ids=["met the ground", "too high", "stopped by thrust"],
)
def test_levels_at_once_when_a_landing_meets_the_ground(
    grounded: Detector, height: float, stop: float, thrust: float, touches: bool
) -> None:
    """Before the thrust is reduced, and before the reference is below the vehicle."""
    down = window_through([0.0, 1.0, 2.0], [[0, 0, height - drop] for drop in (0.0, 0.3, 0.6)])
    sinks, stopped = np.array([0.0, 0.0, -0.3]), np.zeros(3)
    grounded.observe(2.0, thrust=1.2, height=1.0, window=ABOVE)
    grounded.observe(6.0, height=height, thrust=1.0, velocity=sinks, window=down)
    assert grounded.ground.state is GroundState.FLYING
    for left in np.arange(stop, 0.0, -PERIOD):
        velocity = sinks * left / stop
        grounded.observe(height=height, thrust=thrust, velocity=velocity, window=down)
    states = grounded.observe(0.1, height=height, thrust=1.0, velocity=stopped, window=down)
    assert (GroundState.TOUCHING_DOWN in states) is touches


@pytest.mark.parametrize("speed", [0.17, 0.3])
def test_notices_a_contact_with_unknown_ground(detector: Detector, speed: float) -> None:
    """As after a restart in the air: only the end of the descent shows the ground."""
    detector.observe(4.0, height=3.0, thrust=1.0, velocity=sinking(speed), window=descent(speed))
    assert detector.ground.state is GroundState.FLYING
    states = detector.observe(0.4, height=3.0, thrust=1.0, window=descent(speed))
    assert GroundState.TOUCHING_DOWN in states


def test_the_end_of_a_climb_is_not_a_contact(detector: Detector) -> None:
    """Even if the thrust slows the climb less than modelled, and the reference sinks slowly."""
    detector.observe(3.0, height=3.0, thrust=1.0, velocity=sinking(-1.5), window=descent(0.1))
    for climb in np.linspace(1.5, 0.0, 16):
        detector.observe(height=3.0, thrust=0.3, velocity=sinking(-climb), window=descent(0.1))
    states = detector.observe(0.5, height=3.0, thrust=1.0, window=descent(0.1))
    assert set(states) == {GroundState.FLYING}


def sinking(speed: float) -> Array:
    """Return the velocity (3,) of a descent [m/s]."""
    return np.array([0.0, 0.0, -speed])


def descent(speed: float) -> ReferenceWindow:
    """Return a descent from 3 m for 2 s [m/s]."""
    seconds = [0.0, 1.0, 2.0]
    return window_through(seconds, [[0, 0, 3.0 - speed * each] for each in seconds])


def test_reduced_thrust_in_hover_is_not_a_touchdown(grounded: Detector) -> None:
    """A vehicle with more thrust than modelled holds 0.15 m too high at first."""
    hover = ReferenceWindow.hover([0.0, 0.0, 1.0])
    grounded.observe(2.0, thrust=1.2, height=1.0, window=ABOVE)
    grounded.observe(3.0, thrust=1.0, height=1.0, window=hover)
    assert set(grounded.observe(2.0, thrust=0.7, height=1.15, window=hover)) == {
        GroundState.FLYING
    }


def land(detector: Detector, carrying: float) -> ReferenceWindow:
    """Take off, fly with a thrust, and sink; return the reference that leads below the ground."""
    detector.observe(2.0, thrust=1.2 * carrying, height=1.0, window=ABOVE)
    detector.observe(
        3.0, thrust=carrying, height=1.0, window=ReferenceWindow.hover([0.0, 0.0, 1.0])
    )
    down = window_through([0.0, 1.0, 2.0], [[0, 0, 0.0], [0, 0, -0.3], [0, 0, -0.6]])
    sinking = np.array([0.0, 0.0, -0.3])
    detector.observe(0.2, thrust=carrying, height=0.3, velocity=sinking, window=down)
    assert detector.ground.state.is_flying
    assert detector.ground.state is not GroundState.TOUCHING_DOWN
    return down


@pytest.mark.parametrize("says", [False, None])
def test_accepts_landed_but_not_airborne_from_stack(detector: Detector, says: bool | None) -> None:
    detector.ground.landed = True
    states = detector.observe(1.0)
    assert states.index(GroundState.ON_GROUND) * PERIOD == pytest.approx(0.2, abs=0.021)
    detector.ground.landed = says
    assert detector.observe()[-1] is GroundState.ON_GROUND


@pytest.mark.parametrize(
    ("thrust", "speed"), [(1.0, 0.0), (0.0, 2.0)], ids=["with thrust", "in motion"]
)
def test_ignores_landed_from_stack_in_flight(
    detector: Detector, thrust: float, speed: float
) -> None:
    detector.ground.landed = True
    states = detector.observe(
        5.0, thrust=thrust, height=2.0, velocity=np.array([0.0, 0.0, -speed])
    )
    assert GroundState.ON_GROUND not in states


def test_ignores_commands_while_disengaged(detector: Detector) -> None:
    detector.ground.engage(False)
    assert set(detector.observe(5.0, height=2.0)) == {GroundState.UNKNOWN}
    detector.ground.engage(True)
    assert GroundState.ON_GROUND not in detector.observe(0.4)


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.4])
def test_detects_the_ground_with_noisy_velocity(detector: Detector, noise: float) -> None:
    """The noise is correlated over a second, as from estimators, and the height drifts with it."""
    rng = np.random.default_rng(1)
    keep = np.exp(-PERIOD / 1.0)
    velocity, height, states = np.zeros(3), 0.0, []
    for _ in range(3000):
        velocity = keep * velocity + noise * np.sqrt(1.0 - keep**2) * rng.normal(size=3)
        height += PERIOD * (0.3 * velocity[2] - 0.2 * height)
        states += detector.observe(height=height + 0.005 * rng.normal(), velocity=velocity)
    assert np.mean([contact is GroundState.ON_GROUND for contact in states[60:]]) > 0.99


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    scale=st.floats(0.6, 1.5),
    share=st.floats(0.0, 0.45),
    up=st.floats(-2.0, 5.0),
    drag=st.floats(0.0, 1.0),
    updraft=st.floats(-2.0, 2.0),
    noise=st.floats(0.0, 0.4),
)
def test_free_fall_is_never_on_the_ground(
    seed: int, scale: float, share: float, up: float, drag: float, updraft: float, noise: float
) -> None:
    """Thrown up at any speed, with any drag and updraft: the turning point comes at any time."""
    rng = np.random.default_rng(seed)
    detector, height, speed = Detector(), 10.0, up
    for _ in range(100):
        speed += PERIOD * (9.81 * (scale * share - 1.0) - drag * (speed - updraft))
        height += PERIOD * speed
        detector.observe(
            thrust=share,
            height=height + 0.02 * noise * rng.normal(),
            velocity=np.array([0.0, 0.0, speed]) + noise * rng.normal(size=3),
        )
        assert not detector.ground.state.is_on_ground


def test_accepts_landed_state_from_stack_until_engaged(
    detector: Detector,
) -> None:
    detector.ground.engage(False)
    assert set(detector.observe(1.0, thrust=0.9)) == {GroundState.UNKNOWN}
    detector.ground.landed = True
    assert detector.observe()[-1] is GroundState.ON_GROUND
    detector.ground.engage(True)
    assert set(detector.observe(1.0)) == {GroundState.ON_GROUND}
    detector.ground.engage(False)
    detector.ground.landed = False
    assert detector.observe(height=2.0)[-1] is GroundState.UNKNOWN
    detector.ground.engage(True)
    assert detector.observe(thrust=1.0, height=2.0)[-1] is GroundState.UNKNOWN


def test_engaged_in_flight_lands_like_after_take_off(detector: Detector) -> None:
    detector.ground.engage(False)
    detector.ground.landed = True
    detector.observe(1.0)
    detector.ground.landed = False
    for engaged in (True, False, True):
        detector.ground.engage(engaged)
        detector.observe(
            1.0, thrust=1.0, height=2.0, window=ReferenceWindow.hover([0.0, 0.0, 2.0])
        )
    assert detector.ground.state is not GroundState.TOUCHING_DOWN
    detector.observe(2.0, thrust=1.0, height=0.05, window=BELOW)
    detector.observe(0.1, thrust=0.2, height=0.05, window=BELOW)
    assert detector.ground.state is GroundState.TOUCHING_DOWN


@pytest.mark.parametrize("up", [0.5, 0.7, 0.85, 1.0])
def test_tolerates_stronger_updrafts_than_assumed(detector: Detector, up: float) -> None:
    """Half of the fall is kept in reserve: with the worst of thrusts 2.5 m/s^2 do not matter."""
    share, fall = 0.39, 9.81 * (1.0 - 1.5 * 0.39) - 2.5
    for time in PERIOD * np.arange(100):
        velocity = np.array([0.0, 0.0, up - fall * time])
        height = float(up * time - 0.5 * fall * time**2)
        detector.observe(thrust=share, height=height, velocity=velocity)
        assert not detector.ground.state.is_on_ground


def test_detects_the_ground_up_to_the_limit_of_little_thrust(detector: Detector) -> None:
    assert detector.observe(1.0, thrust=0.39)[-1] is GroundState.ON_GROUND


@pytest.mark.parametrize(("gap", "flies"), [(0.4, True), (0.7, False)])
def test_thrust_before_a_long_gap_does_not_count(
    detector: Detector, gap: float, flies: bool
) -> None:
    """An earlier hover counts for half a second at most."""
    detector.observe(1.4, thrust=1.0, height=2.0)
    detector.wait(gap)
    detector.observe(0.1, thrust=1.0, height=2.0)
    assert (detector.ground.state is GroundState.FLYING) is flies


@pytest.mark.parametrize(("rises", "lands"), [(0.007, True), (0.015, False)])
def test_a_reference_that_rises_by_more_than_a_centimetre_climbs(
    detector: Detector, rises: float, lands: bool
) -> None:
    heights = -0.5 + rises * np.array([0.0, 0.5, 1.0])
    window = window_through([0.0, 0.25, 0.5], heights[:, None] * [0.0, 0.0, 1.0])
    assert (GroundState.ON_GROUND in detector.observe(2.0, window=window)) is lands
