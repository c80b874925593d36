"""The detector of the ground: no false detection in the air."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import (
    TRANSITIONS,
    AllowedCommand,
    GroundEvidence,
    GroundState,
    Learning,
    idles,
    idling,
    next_state,
)
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow

MS = 1_000_000
PERIOD = 0.02  # s
BELOW = ReferenceWindow.hover([0.0, 0.0, -0.5])
ABOVE = ReferenceWindow.hover([0.0, 0.0, 1.0])


class Judge:
    """A contact that is shown a vehicle every 20 ms."""

    def __init__(self) -> None:
        self.ground = GroundDetector()
        self._stamp_ns = 0

    def see(
        self,
        seconds: float = PERIOD,
        *,
        thrust: float = 0.0,
        height: float = 0.0,
        velocity: Array | None = None,
        window: ReferenceWindow | None = BELOW,
    ) -> list[GroundState]:
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

    def wait(self, seconds: float) -> None:
        """Show nothing for a while."""
        self._stamp_ns += round(1e9 * seconds)


@pytest.fixture
def judge() -> Judge:
    return Judge()


@pytest.fixture
def standing(judge: Judge) -> Judge:
    judge.see(2.0)
    assert judge.ground.state.is_on_ground
    return judge


def test_detects_standing_at_rest_without_thrust(judge: Judge) -> None:
    said = judge.see(3.0)
    since = said.index(GroundState.ON_GROUND) * PERIOD
    assert 0.5 < since < 0.7
    assert set(said[said.index(GroundState.ON_GROUND) :]) == {GroundState.ON_GROUND}


@pytest.mark.parametrize("share", [1.0 / 1.5, 1.0 / 1.4, 1.0, 1.0 / 0.6])
def test_hover_is_not_standing_for_any_thrust_scale(judge: Judge, share: float) -> None:
    said = judge.see(20.0, thrust=share, height=2.0)
    assert GroundState.ON_GROUND not in said


def test_learns_in_hover_after_spool_up(judge: Judge) -> None:
    said = judge.see(3.0, thrust=1.0, height=2.0)
    assert 1.5 < said.index(GroundState.FLYING) * PERIOD < 2.0
    assert judge.ground.state.is_flying


def test_drift_is_not_lift_off(standing: Judge) -> None:
    """PX4's estimate climbs by 0.1 m/s while it stands; motors spool up half a second."""
    said, height = [], 0.0
    for k in range(300):
        height += 0.12 * PERIOD
        thrust = 0.0 if k < 275 else 0.6
        said += standing.see(thrust=thrust, height=height, window=ABOVE)
    assert set(said) == {GroundState.LIFTING_OFF}
    assert (
        standing.see(1.0, thrust=1.1, height=height + 0.3, window=ABOVE)[-1] is GroundState.FLYING
    )


def test_negative_thrust_curve_counts_as_no_thrust(judge: Judge) -> None:
    assert judge.see(2.0, thrust=-0.05)[-1] is GroundState.ON_GROUND


def test_leaving_its_place_means_flying(judge: Judge) -> None:
    judge.see(0.2, thrust=0.7, height=2.0)
    said = judge.see(0.4, thrust=0.7, height=1.8)
    assert said[-1] is GroundState.FLYING


def test_little_thrust_pauses_learning(judge: Judge) -> None:
    judge.see(3.0, thrust=1.0, height=2.0)
    judge.see(thrust=0.2, height=2.0)
    assert judge.ground.state.is_flying
    assert judge.ground.learning is Learning.PAUSE


def test_landing_pauses_learning_below_half_a_metre(standing: Judge) -> None:
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
        assert standing.ground.state.is_flying
        assert (standing.ground.learning is Learning.PAUSE) is might


def test_reference_above_prevents_standing(judge: Judge) -> None:
    assert GroundState.ON_GROUND not in judge.see(5.0, window=ABOVE)
    heights = np.array([-0.5, -0.45, -0.4])
    rising = ReferenceWindow.through([0.0, 0.25, 0.5], heights[:, None] * [0.0, 0.0, 1.0])
    assert GroundState.ON_GROUND not in judge.see(5.0, window=rising)


def test_it_stands_until_it_has_risen(standing: Judge) -> None:
    assert set(standing.see(1.0, thrust=0.9, window=ABOVE)) == {GroundState.LIFTING_OFF}
    assert standing.ground.allowed is AllowedCommand.LEVEL
    said = [standing.see(thrust=1.1, height=0.01 * k, window=ABOVE)[0] for k in range(60)]
    assert said[0] is GroundState.LIFTING_OFF
    assert 0.1 < 0.01 * said.index(GroundState.FLYING) < 0.3


def test_detects_take_off_after_height_drifted_down(standing: Judge) -> None:
    """PX4's height drifts by 0.2 m during spool-up; then the vehicle climbs with 0.5 m/s^2."""
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
    lifted = 0.25 * times[said.index(GroundState.FLYING)] ** 2
    assert 0.05 < lifted < 0.15


def test_noisy_velocity_is_not_lift_off(standing: Judge) -> None:
    noise = np.random.default_rng(7)
    for _ in range(500):
        velocity = 0.3 * noise.normal(size=3)
        height = 0.01 * float(noise.normal())
        said = standing.see(thrust=0.9, height=height, velocity=velocity, window=ABOVE)
        assert said == [GroundState.LIFTING_OFF]


def test_detects_sideways_take_off_from_slope(standing: Judge) -> None:
    """Leaning by 13 degrees it goes aside by 2 m/s^2 as soon as its thrust carries it."""
    said = []
    for k in range(50):
        velocity = np.array([2.0 * PERIOD * k, 0.0, 0.0])
        said += standing.see(thrust=1.0, velocity=velocity, window=ABOVE)
    assert 0.25 < said.index(GroundState.FLYING) * PERIOD < 0.45


def test_pushed_while_idling_still_stands(standing: Judge) -> None:
    pushed = np.array([0.9, 0.0, 0.0])
    assert set(standing.see(1.0, thrust=0.0, velocity=pushed)) == {GroundState.ON_GROUND}


def test_a_reference_little_above_is_no_request_to_climb(standing: Judge) -> None:
    above = ReferenceWindow.hover([0.0, 0.0, 0.08])
    assert set(standing.see(1.0, window=above)) == {GroundState.ON_GROUND}


def test_what_moves_without_thrust_has_not_come_to_rest(judge: Judge) -> None:
    rolling = np.array([1.4, 0.0, 0.0])
    assert GroundState.ON_GROUND not in judge.see(3.0, velocity=rolling)


def test_learns_only_once_the_ground_has_let_go(standing: Judge) -> None:
    standing.see(0.5, thrust=1.1, window=ABOVE)
    learning = []
    for k in range(100):
        standing.see(thrust=1.1, height=0.02 * k, window=ABOVE)
        learning.append(standing.ground.learning)
    left = 8  # 0.16 m
    assert set(learning) == {Learning.HOLD, Learning.LEARN}
    assert 0.6 < PERIOD * (learning.index(Learning.LEARN) - left) < 1.0


IDLE = idling(ReferenceWindow.hover([0.0, 0.0, 0.0]), 9.81)


def test_recognises_a_reference_that_asks_for_idle_motors() -> None:
    assert idles(IDLE, 9.81) and idles(IDLE, 9.80665)
    assert not idles(ABOVE, 9.81)
    falling = ReferenceWindow.through([0.0, 0.5, 1.0], [[0, 0, 9], [0, 0, 8], [0, 0, 5.1]])
    assert not idles(falling, 9.81)


def test_idles_on_request_where_nothing_is_known(judge: Judge) -> None:
    judge.ground.idle_wanted = True
    assert judge.ground.allowed is AllowedCommand.IDLE
    assert judge.see(1.0, window=IDLE)[-1] is GroundState.ON_GROUND
    assert set(judge.see(5.0, height=-0.5, window=IDLE)) == {GroundState.ON_GROUND}


@pytest.mark.parametrize("height", [0.0, 50.0])
def test_idling_in_the_air_ends_as_it_falls(judge: Judge, height: float) -> None:
    """Requested idling in the air ends after 0.3 s, less than half a metre of fall."""
    judge.see(2.0, thrust=1.0, height=height, window=ReferenceWindow.hover([0.0, 0.0, height]))
    judge.ground.idle_wanted, speed, start = True, 0.0, height
    states = []
    while height > start - 0.5:
        idle = judge.ground.allowed is AllowedCommand.IDLE
        speed -= 9.81 * PERIOD * idle
        height += speed * PERIOD
        velocity = np.array([0.0, 0.0, speed])
        states += judge.see(
            thrust=0.0 if idle else 1.0, height=height, velocity=velocity, window=IDLE
        )
    assert GroundState.TOUCHING_DOWN in states
    assert states[-1] is GroundState.FLYING
    assert GroundState.ON_GROUND not in states


def test_table_is_complete_and_unambiguous() -> None:
    """Every state can be reached and left, and no row is hidden by one before it."""
    assert {row.then for row in TRANSITIONS} | {GroundState.UNKNOWN} == set(GroundState)
    assert {row.state for row in TRANSITIONS} == set(GroundState)
    assert len({(row.state, row.evidence) for row in TRANSITIONS}) == len(TRANSITIONS)
    for row in TRANSITIONS:
        evidence = {row.evidence} if row.present else set()
        assert next_state(row.state, evidence) is row.then
    onto = {row.evidence for row in TRANSITIONS if row.then is GroundState.ON_GROUND}
    assert onto == {GroundEvidence.RESTS, GroundEvidence.CLIMBS}
    back = [row for row in TRANSITIONS if row[1:] == (GroundEvidence.CLIMBS, False, row.then)]
    assert [row.state for row in back] == [GroundState.LIFTING_OFF]


def test_drifting_odometry_is_not_lift_off(standing: Judge) -> None:
    said = [standing.see(height=0.004 * k)[0] for k in range(500)]
    assert set(said) == {GroundState.ON_GROUND}


def test_falling_ends_standing(standing: Judge) -> None:
    """Whyever it was detected, it is over within 0.3 s."""
    speeds = -9.81 * PERIOD * np.arange(60)
    heights = np.cumsum(speeds) * PERIOD
    said = [
        standing.see(height=float(height), velocity=np.array([0.0, 0.0, speed]))[0]
        for height, speed in zip(heights, speeds, strict=True)
    ]
    assert said.index(GroundState.FLYING) * PERIOD <= 0.3


def test_does_not_turn_after_touchdown_at_take_off_place(standing: Judge) -> None:
    standing.see(1.0, thrust=1.1, height=1.0, window=ABOVE)
    assert standing.ground.state is GroundState.FLYING
    for height, thrust, touching in [
        (1.0, 0.3, False),
        (0.2, 1.0, False),
        (0.2, 0.3, True),
    ]:
        standing.see(0.1, thrust=thrust, height=height)
        assert (standing.ground.state is GroundState.TOUCHING_DOWN) is touching
    standing.see(height=0.2, window=ABOVE)
    assert standing.ground.state is not GroundState.TOUCHING_DOWN
    standing.see(height=0.2, velocity=np.array([0.0, 0.0, -20.0]))
    assert standing.ground.state is not GroundState.TOUCHING_DOWN


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_does_not_turn_when_carried_with_reduced_thrust(standing: Judge, carrying: float) -> None:
    """Whatever share of its weight that is by the model."""
    down = land(standing, carrying)
    for _ in range(20):
        standing.see(thrust=0.65 * carrying, height=0.2, window=down)
    assert standing.ground.state is GroundState.TOUCHING_DOWN
    assert not standing.ground.state.is_on_ground


@pytest.mark.parametrize("carrying", [0.7, 1.0, 1.5])
def test_turns_when_falling_with_reduced_thrust(standing: Judge, carrying: float) -> None:
    down, height, speed, share = land(standing, carrying), 0.3, -0.3, 0.65
    for _ in range(20):
        speed -= 9.81 * (1.0 - share) * PERIOD
        height += speed * PERIOD
        velocity = np.array([0.0, 0.0, speed])
        standing.see(thrust=share * carrying, height=height, velocity=velocity, window=down)
        assert standing.ground.state is not GroundState.TOUCHING_DOWN


def test_less_thrust_in_a_hover_is_no_touchdown(standing: Judge) -> None:
    """A vehicle stronger than modelled holds 0.15 m too high, until that is learned."""
    hover = ReferenceWindow.hover([0.0, 0.0, 1.0])
    standing.see(2.0, thrust=1.2, height=1.0, window=ABOVE)
    standing.see(3.0, thrust=1.0, height=1.0, window=hover)
    assert set(standing.see(2.0, thrust=0.7, height=1.15, window=hover)) == {GroundState.FLYING}


def land(judge: Judge, carrying: float) -> ReferenceWindow:
    """Take off, fly with a thrust, and sink; return the reference that leads below the ground."""
    judge.see(2.0, thrust=1.2 * carrying, height=1.0, window=ABOVE)
    judge.see(3.0, thrust=carrying, height=1.0, window=ReferenceWindow.hover([0.0, 0.0, 1.0]))
    down = ReferenceWindow.through([0.0, 1.0, 2.0], [[0, 0, 0.0], [0, 0, -0.3], [0, 0, -0.6]])
    sinking = np.array([0.0, 0.0, -0.3])
    judge.see(0.2, thrust=carrying, height=0.3, velocity=sinking, window=down)
    assert judge.ground.state.is_flying
    assert judge.ground.state is not GroundState.TOUCHING_DOWN
    return down


@pytest.mark.parametrize("says", [False, None])
def test_accepts_landed_but_not_airborne_from_stack(judge: Judge, says: bool | None) -> None:
    judge.ground.set_landed(True)
    said = judge.see(1.0)
    assert said.index(GroundState.ON_GROUND) * PERIOD == pytest.approx(0.2, abs=0.021)
    judge.ground.set_landed(says)
    assert judge.see()[-1] is GroundState.ON_GROUND


@pytest.mark.parametrize(
    ("thrust", "speed"), [(1.0, 0.0), (0.0, 2.0)], ids=["with thrust", "in motion"]
)
def test_ignores_landed_from_stack_in_flight(judge: Judge, thrust: float, speed: float) -> None:
    judge.ground.set_landed(True)
    said = judge.see(5.0, thrust=thrust, height=2.0, velocity=np.array([0.0, 0.0, -speed]))
    assert GroundState.ON_GROUND not in said


def test_ignores_commands_while_disengaged(judge: Judge) -> None:
    judge.ground.engage(False)
    assert set(judge.see(5.0, height=2.0)) == {GroundState.UNKNOWN}
    judge.ground.engage(True)
    assert GroundState.ON_GROUND not in judge.see(0.4)


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.4])
def test_detects_standing_with_noisy_velocity(judge: Judge, noise: float) -> None:
    """The noise is correlated over a second, as from estimators, and the height drifts with it."""
    rng = np.random.default_rng(1)
    keep = np.exp(-PERIOD / 1.0)
    velocity, height, said = np.zeros(3), 0.0, []
    for _ in range(3000):
        velocity = keep * velocity + noise * np.sqrt(1.0 - keep**2) * rng.normal(size=3)
        height += PERIOD * (0.3 * velocity[2] - 0.2 * height)
        said += judge.see(height=height + 0.005 * rng.normal(), velocity=velocity)
    assert np.mean([contact is GroundState.ON_GROUND for contact in said[60:]]) > 0.99


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
def test_free_fall_is_never_standing(
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
        assert not judge.ground.state.is_on_ground


def test_accepts_landed_state_from_stack_until_engaged(
    judge: Judge,
) -> None:
    judge.ground.engage(False)
    assert set(judge.see(1.0, thrust=0.9)) == {GroundState.UNKNOWN}
    judge.ground.set_landed(True)
    assert judge.see()[-1] is GroundState.ON_GROUND
    judge.ground.engage(True)
    assert set(judge.see(1.0)) == {GroundState.ON_GROUND}
    judge.ground.engage(False)
    judge.ground.set_landed(False)
    assert judge.see(height=2.0)[-1] is GroundState.UNKNOWN
    judge.ground.engage(True)
    assert judge.see(thrust=1.0, height=2.0)[-1] is GroundState.UNKNOWN


def test_engaged_in_flight_lands_like_after_take_off(judge: Judge) -> None:
    judge.ground.engage(False)
    judge.ground.set_landed(True)
    judge.see(1.0)
    judge.ground.set_landed(False)
    for engaged in (True, False, True):
        judge.ground.engage(engaged)
        judge.see(1.0, thrust=1.0, height=2.0, window=ReferenceWindow.hover([0.0, 0.0, 2.0]))
    assert judge.ground.state is not GroundState.TOUCHING_DOWN
    judge.see(2.0, thrust=1.0, height=0.05, window=BELOW)
    judge.see(0.1, thrust=0.2, height=0.05, window=BELOW)
    assert judge.ground.state is GroundState.TOUCHING_DOWN


@pytest.mark.parametrize("up", [0.5, 0.7, 0.85, 1.0])
def test_air_may_push_more_than_assumed(judge: Judge, up: float) -> None:
    """Half of the fall is kept in reserve: with the worst of thrusts 2.5 m/s^2 do not matter."""
    share, fall = 0.39, 9.81 * (1.0 - 1.5 * 0.39) - 2.5
    for time in PERIOD * np.arange(100):
        velocity = np.array([0.0, 0.0, up - fall * time])
        height = float(up * time - 0.5 * fall * time**2)
        judge.see(thrust=share, height=height, velocity=velocity)
        assert not judge.ground.state.is_on_ground


def test_it_stands_with_as_much_thrust_as_is_little(judge: Judge) -> None:
    assert judge.see(1.0, thrust=0.39)[-1] is GroundState.ON_GROUND


@pytest.mark.parametrize(("gap", "flies"), [(0.4, True), (0.7, False)])
def test_what_it_did_in_a_long_gap_is_not_known(judge: Judge, gap: float, flies: bool) -> None:
    """An earlier hover counts for half a second at most."""
    judge.see(1.4, thrust=1.0, height=2.0)
    judge.wait(gap)
    judge.see(0.1, thrust=1.0, height=2.0)
    assert (judge.ground.state is GroundState.FLYING) is flies


@pytest.mark.parametrize(("rises", "stands"), [(0.007, True), (0.015, False)])
def test_a_reference_that_rises_by_more_than_a_centimetre_climbs(
    judge: Judge, rises: float, stands: bool
) -> None:
    heights = -0.5 + rises * np.array([0.0, 0.5, 1.0])
    window = ReferenceWindow.through([0.0, 0.25, 0.5], heights[:, None] * [0.0, 0.0, 1.0])
    assert (GroundState.ON_GROUND in judge.see(2.0, window=window)) is stands
