"""Keys as a terminal sends them: repeated while held, and silence when let go."""

from __future__ import annotations

import pytest

from quad_mpc_ros.ros.teleop.keyboard import HELP, MOVES, REQUEST_KEYS, Keyboard, keys_in
from quad_mpc_ros.ros.teleop.motion import STILL, Motion


def held(keyboard: Keyboard, key: str, *, start: float, seconds: float) -> list[float]:
    """Hold a key as a terminal tells it: at once, after 0.5 s, then thirty times a second.

    Returns the forward shares seen every 10 ms until a second after it is let go.
    """
    presses = [start, *(start + 0.5 + k / 30 for k in range(round(30 * (seconds - 0.5))))]
    seen = []
    for k in range(round(100 * (seconds + 1.0))):
        now = start + 0.01 * k
        while presses and presses[0] <= now:
            keyboard.press(key, now=presses.pop(0))
        seen.append(keyboard.motion(now=now).forward)
    return seen


def test_a_held_key_moves_without_a_pause_and_stops_soon_after_it_is_let_go() -> None:
    seen = held(Keyboard(delay=0.7, timeout=0.25), "w", start=3.0, seconds=2.0)
    assert set(seen[:200]) == {1.0}
    assert set(seen[226:]) == {0.0}


def test_a_key_pressed_once_moves_for_the_delay() -> None:
    keyboard = Keyboard(delay=0.7, timeout=0.25)
    keyboard.press("a", now=1.0)
    assert keyboard.motion(now=1.69) == Motion(left=1.0)
    assert keyboard.motion(now=1.71) == STILL


def test_keys_add_up_and_opposite_ones_cancel() -> None:
    keyboard = Keyboard(delay=0.7, timeout=0.25)
    for key in "wdq":
        keyboard.press(key, now=0.0)
    assert keyboard.motion(now=0.1) == Motion(forward=1.0, left=-1.0, yaw=1.0)
    keyboard.press("s", now=0.2)
    assert keyboard.motion(now=0.3) == Motion(left=-1.0, yaw=1.0)
    keyboard.release()
    assert keyboard.motion(now=0.3) == STILL


@pytest.mark.parametrize(
    ("sent", "keys"),
    [
        ("wWt", ["w", "w", "t"]),
        ("\x1b[A\x1b[B\x1b[C\x1b[D", ["w", "s", "d", "a"]),
        ("\x1bOA", ["w"]),  # in application mode
        ("\x1b[1;5A", []),  # with Ctrl: not that key
        ("\x1b[3~l", ["l"]),  # delete, then l: its ~ is no key
        ("\x1b", []),
        ("", []),
    ],
)
def test_arrows_are_letters_and_other_sequences_are_nothing(sent: str, keys: list[str]) -> None:
    assert keys_in(sent) == keys


def test_the_help_names_every_key() -> None:
    words = HELP.replace(",", " ").split()
    for key in [*MOVES, *REQUEST_KEYS]:
        assert ("space)" if key == " " else key) in words
