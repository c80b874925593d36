"""Showing how far something is: one line that rewrites itself, or a line a second in a log."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 1.0


class _Line:
    """A line on standard error, now and then another one."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._period = _TERMINAL_PERIOD if self._terminal else _LOG_PERIOD
        self.started = time.monotonic()
        self._due = self.started

    @property
    def due(self) -> bool:
        """Whether it is time to show something."""
        return time.monotonic() >= self._due

    def write(self, line: str) -> None:
        """Show a line in place of the last one."""
        self._due = time.monotonic() + self._period
        if self._terminal:
            print(f"\r{line:<78}", end="", file=sys.stderr, flush=True)
        else:
            print(line, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the line."""
        if self._terminal:
            print(file=sys.stderr)


class Progress(_Line):
    """Prints the time flown and the position error to standard error."""

    def __init__(self, duration: float) -> None:
        super().__init__()
        self._duration = duration

    def show(self, flown: float, position_error: float | None) -> None:
        """Show ``flown`` seconds of flight and the position error [m]."""
        error = "" if position_error is None else f"   position error {position_error:6.3f} m"
        speed = flown / max(time.monotonic() - self.started, 1e-6)
        self.write(f"  {flown:6.1f} s of {self._duration:g} s   {speed:5.2f} x real time{error}")


class CountProgress(_Line):
    """Prints how many flights are done, how many of them crashed, and the time left."""

    def __init__(self) -> None:
        super().__init__()
        self._first: int | None = None

    def show(self, done: int, total: int, crashed: int) -> None:
        """Show how many of all flights are done and how many crashed."""
        if not self.due and done < total:
            return
        elapsed = time.monotonic() - self.started
        if self._first is None:  # what a resumed campaign had done before took no time here
            self._first = done
        left = (total - done) * elapsed / max(done - self._first, 1)
        when = f"   {left:5.0f} s left" if done > self._first else ""
        self.write(f"  {done} of {total} flights, {crashed} crashed{when}")


class PlanProgress(_Line):
    """Prints what an optimiser is at."""

    def show(self, stage: str, iteration: int, planned: float) -> None:
        """Show the stage, its iteration, and how long the plan takes so far [s]."""
        if self.due:
            since = time.monotonic() - self.started
            self.write(f"  {stage}: iteration {iteration}, {planned:.3f} s   after {since:.0f} s")


class StudyProgress(_Line):
    """Prints how far a study is, the best objectives so far, and the time left."""

    def show(self, how_far: str, *, best: Sequence[float], left: float) -> None:
        """Show the progress, the best objectives, and the seconds left, NaN if unknown."""
        if not self.due:
            return
        so_far = f"   best {' '.join(f'{value:.3g}' for value in best)}" if best else ""
        when = f"   {left:5.0f} s left" if math.isfinite(left) else ""
        self.write(f"  {how_far}{so_far}{when}")
