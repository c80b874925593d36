"""Standing on the ground is told from flying, and never the other way round in the air."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.estimation.contact import Contact, GroundContact
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

MS = 1_000_000
PERIOD = 0.02  # s
BELOW = ReferenceWindow.hover([0.0, 0.0, -0.5])
ABOVE = ReferenceWindow.hover([0.0, 0.0, 1.0])


class Judge:
    """A contact that is shown a vehicle every 20 ms."""

    def __init__(self) -> None:
        self.ground = GroundContact()
        self._stamp_ns = 0

    def see(
        self,
        seconds: float = PERIOD,
        *,
        thrust: float = 0.0,
        height: float = 0.0,
        velocity: Array | None = None,
        window: ReferenceWindow | None = BELOW,
    ) -> list[Contact]:
        """Return what is said while nothing changes."""
        said = []
        for _ in range(round(seconds / PERIOD)):
            odometry = OdometrySample(
                stamp_ns=self._stamp_ns,
                p_WB=np.array([0.0, 0.0, height]),
                q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
                v_WB_B=np.zeros(3) if velocity is None else velocity,
                w_WB_B=np.zeros(3),
            )
            said.append(self.ground.update(odometry, thrust=thrust, window=window))
            self._stamp_ns += 20 * MS
        return said


@pytest.fixture
def judge() -> Judge:
    return Judge()


@pytest.fixture
def standing(judge: Judge) -> Judge:
    judge.see(2.0)
    assert judge.ground.standing
    return judge


def test_at_rest_without_thrust_it_stands_after_a_while(judge: Judge) -> None:
    said = judge.see(3.0)
    since = said.index(Contact.STANDING) * PERIOD
    assert 0.5 < since < 0.7
    assert set(said[said.index(Contact.STANDING) :]) == {Contact.STANDING}


@pytest.mark.parametrize("share", [1.0 / 1.5, 1.0 / 1.4, 1.0, 1.0 / 0.6])
def test_hover_is_not_standing_for_any_thrust_scale(judge: Judge, share: float) -> None:
    said = judge.see(20.0, thrust=share, height=2.0)
    assert Contact.STANDING not in said


def test_a_hover_teaches_after_the_time_that_motors_spool_up_for(judge: Judge) -> None:
    said = judge.see(3.0, thrust=1.0, height=2.0)
    assert 1.5 < said.index(Contact.FLYING) * PERIOD < 2.0
    assert judge.ground.flies


def test_drifting_odometry_does_not_lift_off(standing: Judge) -> None:
    """PX4's estimate climbs by 0.1 m/s while it stands; motors spool up half a second."""
    said, height = [], 0.0
    for k in range(300):
        height += 0.12 * PERIOD
        thrust = 0.0 if k < 275 else 0.6
        said += standing.see(thrust=thrust, height=height, window=ABOVE)
    assert set(said) == {Contact.STANDING}
    assert standing.see(1.0, thrust=1.1, height=height + 0.3, window=ABOVE)[-1] is Contact.FLYING


def test_a_curve_that_is_negative_without_throttle_is_no_thrust(judge: Judge) -> None:
    assert judge.see(2.0, thrust=-0.05)[-1] is Contact.STANDING


def test_leaving_its_position_means_flying(judge: Judge) -> None:
    judge.see(0.2, thrust=0.7, height=2.0)
    said = judge.see(0.4, thrust=0.7, height=1.8)
    assert said[-1] is Contact.FLYING


def test_learns_nothing_with_little_thrust(judge: Judge) -> None:
    judge.see(3.0, thrust=1.0, height=2.0)
    judge.see(thrust=0.2, height=2.0)
    assert judge.ground.flies
    assert judge.ground.may_touch


def test_in_a_landing_the_ground_might_carry_it_from_half_a_metre_on(standing: Judge) -> None:
    standing.see(1.0, thrust=1.1, height=2.0, window=ABOVE)
    down = ReferenceWindow.through([0.0, 1.0, 2.0], [[0, 0, 0.3], [0, 0, 0.0], [0, 0, -0.3]])
    for height, window, might in [
        (1.0, down, False),
        (0.3, down, True),
        (0.25, down, True),
        (0.3, ReferenceWindow.hover([0.0, 0.0, 0.3]), False),
        (0.3, ABOVE, False),
    ]:
        standing.see(thrust=1.0, height=height, window=window)
        assert standing.ground.flies
        assert standing.ground.may_touch is might


def test_a_reference_that_asks_for_height_lets_it_not_count_as_standing(judge: Judge) -> None:
    assert Contact.STANDING not in judge.see(5.0, window=ABOVE)
    heights = np.array([-0.5, -0.45, -0.4])
    rising = ReferenceWindow.through([0.0, 0.25, 0.5], heights[:, None] * [0.0, 0.0, 1.0])
    assert Contact.STANDING not in judge.see(5.0, window=rising)


def test_it_stands_until_it_has_risen(standing: Judge) -> None:
    assert set(standing.see(1.0, thrust=0.9, window=ABOVE)) == {Contact.STANDING}
    assert standing.ground.asks_for_height
    said = [standing.see(thrust=1.1, height=0.01 * k, window=ABOVE)[0] for k in range(60)]
    assert said[0] is Contact.STANDING
    assert 0.1 < 0.01 * said.index(Contact.FLYING) < 0.3


def test_takeoff_counts_after_sunken_estimate(standing: Judge) -> None:
    """As that of PX4, by 0.2 m as its motors spool up; then it climbs by 0.5 m/s^2."""
    for k in range(50):
        standing.see(thrust=0.01 * k + 0.45, height=-0.004 * k, window=ABOVE)
    times = PERIOD * np.arange(80)
    said = [
        standing.see(
            thrust=1.05,
            height=-0.2 + 0.25 * time**2,
            velocity=np.array([0.0, 0.0, 0.5 * time]),
            window=ABOVE,
        )[0]
        for time in times
    ]
    lifted = 0.25 * times[said.index(Contact.FLYING)] ** 2
    assert 0.05 < lifted < 0.15


def test_noisy_speeds_do_not_lift_off(standing: Judge) -> None:
    noise = np.random.default_rng(7)
    for _ in range(500):
        velocity = 0.3 * noise.normal(size=3)
        height = 0.01 * float(noise.normal())
        said = standing.see(thrust=0.9, height=height, velocity=velocity, window=ABOVE)
        assert said == [Contact.STANDING]


def test_takeoff_from_slope_gets_rates_early(standing: Judge) -> None:
    """Leaning by 13 degrees it goes aside by 2 m/s^2 as soon as its thrust carries it."""
    said = []
    for k in range(50):
        velocity = np.array([2.0 * PERIOD * k, 0.0, 0.0])
        said += standing.see(thrust=1.0, velocity=velocity, window=ABOVE)
    assert 0.25 < said.index(Contact.FLYING) * PERIOD < 0.45


def test_idle_vehicle_may_be_moved(standing: Judge) -> None:
    pushed = np.array([0.9, 0.0, 0.0])
    assert set(standing.see(1.0, thrust=0.0, velocity=pushed)) == {Contact.STANDING}


def test_drifting_odometry_is_no_takeoff(standing: Judge) -> None:
    said = [standing.see(height=0.004 * k)[0] for k in range(500)]
    assert set(said) == {Contact.STANDING}


def test_falling_vehicle_was_not_standing(standing: Judge) -> None:
    """However it came to be believed: it is over within 0.3 s."""
    speeds = -9.81 * PERIOD * np.arange(60)
    heights = np.cumsum(speeds) * PERIOD
    said = [
        standing.see(height=float(height), velocity=np.array([0.0, 0.0, speed]))[0]
        for height, speed in zip(heights, speeds, strict=True)
    ]
    assert said.index(Contact.FLYING) * PERIOD <= 0.3


def test_no_rates_when_descending_to_ground(standing: Judge) -> None:
    standing.see(1.0, thrust=1.1, height=1.0, window=ABOVE)
    assert standing.ground.contact is Contact.FLYING
    for height, thrust, touching in [
        (1.0, 0.3, False),
        (0.2, 1.0, False),
        (0.2, 0.3, True),
    ]:
        standing.see(0.1, thrust=thrust, height=height)
        assert standing.ground.touching is touching
    standing.see(height=0.2, window=ABOVE)
    assert not standing.ground.touching
    standing.see(height=0.2, velocity=np.array([0.0, 0.0, -20.0]))
    assert not standing.ground.touching


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_no_rates_when_carried_by_the_ground(standing: Judge, carrying: float) -> None:
    """Whatever share of its weight that is by the model."""
    down = land(standing, carrying)
    for _ in range(20):
        standing.see(thrust=0.65 * carrying, height=0.2, window=down)
    assert standing.ground.touching
    assert not standing.ground.standing


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_rates_continue_in_a_fall(standing: Judge, carrying: float) -> None:
    down, height, speed, share = land(standing, carrying), 0.3, -0.3, 0.65
    for _ in range(20):
        speed -= 9.81 * (1.0 - share) * PERIOD
        height += speed * PERIOD
        velocity = np.array([0.0, 0.0, speed])
        standing.see(thrust=share * carrying, height=height, velocity=velocity, window=down)
        assert not standing.ground.touching


def land(judge: Judge, carrying: float) -> ReferenceWindow:
    """Take off, fly with a thrust, and sink; return the reference that leads below the ground."""
    judge.see(2.0, thrust=1.2 * carrying, height=1.0, window=ABOVE)
    judge.see(3.0, thrust=carrying, height=1.0, window=ReferenceWindow.hover([0.0, 0.0, 1.0]))
    down = ReferenceWindow.through([0.0, 1.0, 2.0], [[0, 0, 0.0], [0, 0, -0.3], [0, 0, -0.6]])
    sinking = np.array([0.0, 0.0, -0.3])
    judge.see(0.2, thrust=carrying, height=0.3, velocity=sinking, window=down)
    assert judge.ground.flies
    assert not judge.ground.touching
    return down


@pytest.mark.parametrize("says", [False, None])
def test_accepts_reported_landed_but_not_its_absence(judge: Judge, says: bool | None) -> None:
    judge.ground.tell_landed(True)
    said = judge.see(1.0)
    assert said.index(Contact.STANDING) * PERIOD == pytest.approx(0.2, abs=0.021)
    judge.ground.tell_landed(says)
    assert judge.see()[-1] is Contact.STANDING


@pytest.mark.parametrize(
    ("thrust", "speed"), [(1.0, 0.0), (0.0, 2.0)], ids=["with thrust", "in motion"]
)
def test_ignores_reported_landed_in_flight(judge: Judge, thrust: float, speed: float) -> None:
    judge.ground.tell_landed(True)
    said = judge.see(5.0, thrust=thrust, height=2.0, velocity=np.array([0.0, 0.0, -speed]))
    assert Contact.STANDING not in said


def test_commands_are_ignored_while_disengaged(judge: Judge) -> None:
    judge.ground.engage(False)
    assert set(judge.see(5.0, height=2.0)) == {Contact.UNKNOWN}
    judge.ground.engage(True)
    assert Contact.STANDING not in judge.see(0.4)


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.4])
def test_noisy_speeds_hide_no_ground(judge: Judge, noise: float) -> None:
    """As estimators make them: correlated for a second, and the height drifts with them."""
    rng = np.random.default_rng(1)
    keep = np.exp(-PERIOD / 1.0)
    velocity, height, said = np.zeros(3), 0.0, []
    for _ in range(3000):
        velocity = keep * velocity + noise * np.sqrt(1.0 - keep**2) * rng.normal(size=3)
        height += PERIOD * (0.3 * velocity[2] - 0.2 * height)
        said += judge.see(height=height + 0.005 * rng.normal(), velocity=velocity)
    assert np.mean([contact is Contact.STANDING for contact in said[60:]]) > 0.99


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
def test_no_fall_is_ever_taken_for_standing(
    seed: int, scale: float, share: float, up: float, drag: float, updraft: float, noise: float
) -> None:
    """Thrown up at any speed, in any air, so that its rest at the top may come at any time."""
    rng = np.random.default_rng(seed)
    judge, height, speed = Judge(), 10.0, up
    for _ in range(100):
        speed += PERIOD * (9.81 * (scale * share - 1.0) - drag * (speed - updraft))
        height += PERIOD * speed
        judge.see(
            thrust=share,
            height=height + 0.02 * noise * rng.normal(),
            velocity=np.array([0.0, 0.0, speed]) + noise * rng.normal(size=3),
        )
        assert not judge.ground.standing


def test_accepts_reported_landed_until_engaged(
    judge: Judge,
) -> None:
    judge.ground.engage(False)
    assert set(judge.see(1.0, thrust=0.9)) == {Contact.UNKNOWN}
    judge.ground.tell_landed(True)
    assert judge.see()[-1] is Contact.STANDING
    judge.ground.engage(True)
    assert set(judge.see(1.0)) == {Contact.STANDING}
    judge.ground.engage(False)
    judge.ground.tell_landed(False)
    assert judge.see(height=2.0)[-1] is Contact.UNKNOWN
    judge.ground.engage(True)
    assert judge.see(thrust=1.0, height=2.0)[-1] is Contact.UNKNOWN


def test_landing_after_engaging_in_air_is_careful(judge: Judge) -> None:
    judge.ground.engage(False)
    judge.ground.tell_landed(True)
    judge.see(1.0)
    judge.ground.tell_landed(False)
    for engaged in (True, False, True):
        judge.ground.engage(engaged)
        judge.see(1.0, thrust=1.0, height=2.0, window=ReferenceWindow.hover([0.0, 0.0, 2.0]))
    assert not judge.ground.touching
    judge.see(2.0, thrust=1.0, height=0.05, window=BELOW)
    judge.see(0.1, thrust=0.2, height=0.05, window=BELOW)
    assert judge.ground.touching
