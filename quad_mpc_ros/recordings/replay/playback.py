"""Due times of the messages of a bag: rate, pause and clock. No function of this module waits.

All times are integers in nanoseconds. *Steady* times are from the clock that drives the playback;
*recorded* times are log times of the bag.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from quad_mpc_ros.recordings.reader import RecordedMessage

_S = 1_000_000_000


class PlaybackTimeline:
    """The recorded time at a steady time.

    The relation is linear from the last start or pause: a late message does not delay later
    messages.
    """

    def __init__(self, *, recorded_ns: int, steady_ns: int, rate: float, paused: bool) -> None:
        self._recorded_ns = recorded_ns
        self._steady_ns = steady_ns
        self._rate = rate
        self.paused = paused

    def recorded_ns(self, steady_ns: int) -> int:
        """Return the recorded time at a steady time; before the start it is constant."""
        if self.paused:
            return self._recorded_ns
        elapsed = max(0, steady_ns - self._steady_ns)
        return self._recorded_ns + round(elapsed * self._rate)

    def steady_ns(self, recorded_ns: int) -> int:
        """Return the steady time at which a recorded time is reached, unless paused."""
        return self._steady_ns + round((recorded_ns - self._recorded_ns) / self._rate)

    def is_due(self, recorded_ns: int, steady_ns: int) -> bool:
        """Whether a recorded time is reached at a steady time."""
        return not self.paused and self.steady_ns(recorded_ns) <= steady_ns

    def set_paused(self, paused: bool, steady_ns: int) -> None:
        """Pause or resume at a steady time."""
        self._recorded_ns = self.recorded_ns(steady_ns)
        # A pause before the start does not bring the start forward.
        self._steady_ns = max(steady_ns, self._steady_ns)
        self.paused = paused


class Playback:
    """Publishes messages when due, and the recorded time at regular intervals."""

    def __init__(
        self,
        messages: Iterator[RecordedMessage],
        *,
        timeline: PlaybackTimeline,
        publish: Callable[[RecordedMessage], None],
        publish_clock: Callable[[int], None],
        clock_rate: float,
    ) -> None:
        """``publish_clock`` gets the recorded time at ``clock_rate`` [Hz]; 0 disables it."""
        self._messages = messages
        self._next = next(messages, None)
        self._timeline = timeline
        self._publish = publish
        self._publish_clock = publish_clock
        self._clock_period_ns = round(_S / clock_rate) if clock_rate else 0
        self._clock_at_ns = 0
        self.count = 0
        """The number of published messages."""

    @property
    def finished(self) -> bool:
        """Whether the last message has been published."""
        return self._next is None

    def step(self, steady_ns: int) -> int | None:
        """Publish messages due at a steady time; return the time of the next action.

        None means no action until the timeline resumes, or the end.
        """
        if self._clock_period_ns and steady_ns >= self._clock_at_ns:
            self._tick(steady_ns)
        while self._next and self._timeline.is_due(self._next.log_time_ns, steady_ns):
            self._publish(self._next)
            self.count += 1
            self._next = next(self._messages, None)
        return self._next_step_ns()

    def _tick(self, steady_ns: int) -> None:
        self._publish_clock(self._timeline.recorded_ns(steady_ns))
        missed = (steady_ns - self._clock_at_ns) // self._clock_period_ns
        self._clock_at_ns += (1 + missed) * self._clock_period_ns

    def _next_step_ns(self) -> int | None:
        if self._next is None:
            return None
        times = [self._clock_at_ns] if self._clock_period_ns else []
        if not self._timeline.paused:
            times.append(self._timeline.steady_ns(self._next.log_time_ns))
        return min(times, default=None)
