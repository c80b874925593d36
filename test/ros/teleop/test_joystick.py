"""A joystick: its deadman button, its loss, its axes and buttons."""

from __future__ import annotations

import math

import pytest

from quad_mpc_ros.ros.teleop.config import JoystickParameters
from quad_mpc_ros.ros.teleop.joystick import Joystick
from quad_mpc_ros.ros.teleop.motion import STILL, Latch, Motion, Steps, stepped

CONFIG = JoystickParameters()
AXES = 6


def message(
    *, forward: float = 0.0, yaw: float = 0.0, pressed: tuple[str, ...] = ()
) -> tuple[list[float], list[int]]:
    axes, buttons = [0.0] * AXES, [0] * 15
    axes[CONFIG.forward_axis], axes[CONFIG.yaw_axis] = forward, yaw
    for name in pressed:
        buttons[getattr(CONFIG, f"{name}_button")] = 1
    return axes, buttons


def test_sticks_count_only_while_the_deadman_button_is_held() -> None:
    joystick = Joystick(CONFIG)
    joystick.receive(*message(forward=1.0, yaw=-1.0), now=0.0)
    assert joystick.motion(now=0.0) == STILL
    joystick.receive(*message(forward=1.0, yaw=-1.0, pressed=("deadman",)), now=0.1)
    assert joystick.motion(now=0.1) == Motion(forward=1.0, yaw=-1.0)


def test_a_joystick_that_is_silent_counts_as_let_go() -> None:
    joystick = Joystick(CONFIG)
    assert not joystick.was_there
    joystick.receive(*message(), now=-0.1)
    joystick.receive(*message(forward=1.0, pressed=("deadman",)), now=0.0)
    assert joystick.motion(now=CONFIG.timeout - 0.01) != STILL
    assert joystick.motion(now=CONFIG.timeout + 0.01) == STILL


def test_a_request_is_made_once_as_its_button_is_pressed() -> None:
    joystick = Joystick(CONFIG)
    made = []
    for k, pressed in enumerate(((), ("land",), ("land",), (), ("land",))):
        made += joystick.receive(*message(pressed=pressed), now=0.05 * k)
    assert made == ["land", "land"]


def test_take_off_and_start_need_the_deadman_button_and_hold_and_land_do_not() -> None:
    made = {}
    for deadman in ((), ("deadman",)):
        for name in ("takeoff", "start", "hold", "land"):
            joystick = Joystick(CONFIG)
            joystick.receive(*message(), now=-0.1)
            joystick.receive(*message(pressed=deadman), now=0.0)
            made[name, bool(deadman)] = joystick.receive(
                *message(pressed=(*deadman, name)), now=0.05
            )
    assert [key for key, found in made.items() if not found] == [
        ("takeoff", False),
        ("start", False),
    ]
    assert all(found in ([], [name]) for (name, _), found in made.items())


def test_a_button_that_is_pressed_when_the_joystick_returns_asks_for_nothing() -> None:
    joystick = Joystick(CONFIG)
    assert joystick.receive(*message(pressed=("deadman", "takeoff")), now=0.0) == []
    joystick.receive(*message(), now=0.1)
    assert joystick.receive(*message(pressed=("land",)), now=5.0) == []


def test_a_deadman_button_that_is_held_when_the_joystick_comes_counts_once_let_go() -> None:
    """A driver may go on telling what was held when the joystick was unplugged."""
    joystick, pushed = Joystick(CONFIG), message(forward=1.0, pressed=("deadman",))
    for begin in (0.0, 10.0):  # at first, and after a loss
        for k in range(5):
            joystick.receive(*pushed, now=begin + 0.05 * k)
            assert joystick.motion(now=begin + 0.05 * k) == STILL
        joystick.receive(*message(forward=1.0), now=begin + 0.3)
        joystick.receive(*pushed, now=begin + 0.35)
        assert joystick.motion(now=begin + 0.35) == Motion(forward=1.0)


@pytest.mark.parametrize(
    ("value", "share"),
    [(0.1, 0.0), (-0.1, 0.0), (0.55, 0.5), (-1.0, -1.0), (3.0, 1.0), (math.nan, 0.0)],
)
def test_a_share_rises_from_the_edge_of_the_deadzone(value: float, share: float) -> None:
    joystick = Joystick(CONFIG)
    joystick.receive(*message(), now=-0.1)
    joystick.receive(*message(forward=value, pressed=("deadman",)), now=0.0)
    assert joystick.motion(now=0.0).forward == pytest.approx(share)


def test_axes_may_be_reversed() -> None:
    config = JoystickParameters(reversed_axes=(CONFIG.forward_axis,))
    joystick = Joystick(config)
    joystick.receive(*message(), now=-0.1)
    joystick.receive(*message(forward=1.0, pressed=("deadman",)), now=0.0)
    assert joystick.motion(now=0.0).forward == -1.0


def test_axes_and_buttons_that_are_not_there_are_named_and_do_nothing() -> None:
    joystick = Joystick(CONFIG)
    joystick.receive([1.0, 1.0], [1], now=0.0)
    assert joystick.motion(now=0.0) == STILL
    assert joystick.missing == "forward_axis 3, left_axis 2, deadman_button 9"


def test_after_a_request_a_pushed_stick_does_nothing_until_it_was_let_go() -> None:
    latch, pushed = Latch(), Motion(forward=0.7)
    assert latch.passed(pushed) == pushed
    latch.close()
    assert latch.passed(pushed) == STILL
    assert latch.passed(STILL) == STILL
    assert latch.passed(pushed) == pushed


def test_steps_come_once_a_period_while_a_stick_is_pushed_beyond_its_half() -> None:
    steps = Steps(0.5)
    pushed = Motion(forward=0.6, yaw=0.3)
    made = [steps.step(pushed, now=0.1 * k) for k in range(11)]
    assert [k for k, step in enumerate(made) if step is not None] == [0, 5, 10]
    assert made[0] == Motion(forward=1.0)
    assert steps.step(STILL, now=1.1) is None
    assert steps.step(pushed, now=1.15) is not None  # pushed anew


def test_a_step_leads_where_the_nose_points_and_yaw_wraps() -> None:
    p_WB, yaw = stepped(
        [1.0, 2.0, 1.5], math.pi / 2, Motion(forward=1.0, up=-1.0), length=0.5, turn=0.4
    )
    assert p_WB == pytest.approx([1.0, 2.5, 1.0])
    assert yaw == pytest.approx(math.pi / 2)
    _, yaw = stepped([0.0, 0.0, 1.0], 3.0, Motion(yaw=1.0), length=0.5, turn=0.4)
    assert yaw == pytest.approx(3.4 - math.tau)
