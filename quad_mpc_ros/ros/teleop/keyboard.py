"""The keys: what each is for, and which of them count as held.

A terminal tells no releases: it repeats what is held, after a delay. A key counts as held until
the repetition should have come.
"""

from __future__ import annotations

import re

from quad_mpc_ros.ros.teleop.motion import Motion

HELP = """\
  w s  forward, back        t  take-off           + -  faster, slower
  a d  left, right          g  start trajectory   m    velocity or steps
  r f  up, down             h  hold (or space)    x    end (or Ctrl-C)
  q e  turn left, right     l  land
Hold a key to move; let it go to stop. Arrow keys are w a s d."""

MOVES = {
    "w": Motion(forward=1.0),
    "s": Motion(forward=-1.0),
    "a": Motion(left=1.0),
    "d": Motion(left=-1.0),
    "r": Motion(up=1.0),
    "f": Motion(up=-1.0),
    "q": Motion(yaw=1.0),
    "e": Motion(yaw=-1.0),
}
_ARROWS = {"\x1b[A": "w", "\x1b[B": "s", "\x1b[D": "a", "\x1b[C": "d"}
REQUEST_KEYS = {"t": "takeoff", "g": "start", "h": "hold", " ": "hold", "l": "land"}
_ESCAPE = re.compile(r"\x1b(?:[\[O][0-?]*[ -/]*[@-~]|.)?", re.DOTALL)


def keys_in(text: str) -> list[str]:
    """Return the keys of what a terminal sent, arrows as the letters that they stand for."""
    keys: list[str] = []
    at = 0
    for found in _ESCAPE.finditer(text):
        keys += text[at : found.start()]
        arrow = _ARROWS.get(found[0].replace("\x1bO", "\x1b["))
        keys += [] if arrow is None else [arrow]
        at = found.end()
    keys += text[at:]
    return [key.lower() for key in keys]


class Keyboard:
    """Which of the moving keys count as held; times in seconds of one clock."""

    def __init__(self, *, delay: float, timeout: float) -> None:
        self._delay, self._timeout = delay, timeout
        self._until: dict[str, float] = {}

    def press(self, key: str, *, now: float) -> None:
        """Take one of the keys that move."""
        repeated = self._until.get(key, now) > now
        self._until[key] = now + (self._timeout if repeated else self._delay)

    def release(self) -> None:
        """Let all keys go."""
        self._until.clear()

    def motion(self, *, now: float) -> Motion:
        """Return what is asked for by the keys that count as held."""
        self._until = {key: until for key, until in self._until.items() if until > now}
        moves = [MOVES[key] for key in self._until]
        return Motion(*(sum(shares) for shares in zip(*moves, strict=True))) if moves else Motion()
