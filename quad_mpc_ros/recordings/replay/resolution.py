"""Feed a recorded flight to a controller: what would it have commanded?

Whatever the controller answers, the next odometry is the recorded one, and so is the command on
its way to the vehicle. With the configuration of the flight the answers are those of the flight,
bit for bit, where the recording has what the controller knew and when.
"""

from __future__ import annotations

import bisect
import dataclasses
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.recordings.logs import Received
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.recordings.run import RecordedRun

S = TypeVar("S", CommandSample, ReferenceWindow)

WindowSource = Callable[[int], ReferenceWindow]
"""Returns the reference window of a stamp [ns], in place of the recorded ones."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resolved:
    """What the controller answered; ``odometry`` is None where the watchdog acted.

    ``now_ns`` is the controller's time. ``window`` is the newest that it had.
    """

    now_ns: int
    odometry: Received[OdometrySample] | None
    window: ReferenceWindow | None
    tick: Tick | None

    @property
    def log_time_ns(self) -> int:
        """When the odometry was recorded [ns]; the controller's time where there is none."""
        return self.now_ns if self.odometry is None else self.odometry.log_time_ns


def resolve(
    run: RecordedRun,
    config: MpcConfig,
    *,
    windows: WindowSource | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> Iterator[Resolved]:
    """Yield every odometry of a recorded flight with what a controller answers to it.

    Live parameters that were set in flight are set again, except those that differ in ``config``
    from the values at the start of the flight. ``windows`` replaces the recorded reference.
    ``warn`` gets what the controller would have logged.
    """
    if config.uses_accelerometer and config.lockstep and not run.imu:
        warn("no imu in the recording: without accelerometer_noise")
        config = dataclasses.replace(config, accelerometer_noise=0.0)
    controller = Controller(config)
    sent = _first_by_stamp(run.commands)
    window: ReferenceWindow | None = None
    engagements, landings = deque(run.engagements), deque(run.landings)
    resets = deque(run.resets)
    imu_samples = _ImuSamples(run)
    changes = _Changes(run, config)

    def reset_estimate_until(now_ns: int) -> None:
        while resets and resets[0].publish_time_ns <= now_ns:
            controller.reset_estimate(resets.popleft().value)

    for event in _events(run, config, windows):
        while engagements and engagements[0].publish_time_ns <= event.now_ns:
            controller.engage(engagements.popleft().value)
        while landings and landings[0].publish_time_ns <= event.now_ns:
            controller.landed(landings.popleft().value)
        # Windows that no tick used change nothing.
        if event.window is not None and event.window is not window:
            window = event.window
            reset_estimate_until(event.window_ns)  # a later reset moved this window as well
            controller.receive_reference(window, now_ns=event.window_ns)
        reset_estimate_until(event.now_ns)
        changed = changes.before(event)
        if changed is not None:
            controller.reconfigure(changed)
        if event.odometry is not None:
            for sample in imu_samples.until(event.odometry.value.stamp_ns):
                controller.receive_imu(sample)
        if event.odometry is None:
            tick = controller.watch(now_ns=event.now_ns)
        else:
            controller.check_stamps(not event.answered)
            tick = controller.receive_odometry(event.odometry.value, now_ns=event.now_ns)
        for warning in controller.take_warnings():
            warn(warning)
        if tick is not None and tick.stats.stamp_ns in sent:
            controller.replace_last_command(sent[tick.stats.stamp_ns], now_ns=event.now_ns)
        yield Resolved(now_ns=event.now_ns, odometry=event.odometry, window=window, tick=tick)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Event:
    """An odometry, or the watchdog, with the window in force and when that was received.

    An odometry that was ``answered`` had not been refused.
    """

    now_ns: int
    odometry: Received[OdometrySample] | None = None
    window: ReferenceWindow | None = None
    window_ns: int = 0
    answered: bool = False


class _ImuSamples:
    """What an accelerometer measured, and what of it the controller had at an odometry.

    The figures of its tick say so. Where they do not it is what was measured by its stamp.
    """

    def __init__(self, run: RecordedRun) -> None:
        self._due = deque(received.value for received in run.imu)
        self._had_ns = {
            stats.stamp_ns: stats.imu_stamp_ns for stats in run.stats if stats.imu_stamp_ns
        }

    def until(self, stamp_ns: int) -> Iterator[ImuSample]:
        """Yield what came since the odometry before."""
        had_ns = self._had_ns.get(stamp_ns, stamp_ns)
        while self._due and self._due[0].stamp_ns <= had_ns:
            yield self._due.popleft()


class _Changes:
    """The parameters that were set in flight, one after the other.

    One thread sets parameters and sends commands, so a change published before a command applied
    to it. Stamps do not order them: in simulated time they are equal.
    """

    def __init__(self, run: RecordedRun, config: MpcConfig) -> None:
        self._config = config
        began = recorded_parameters(run.parameters, MpcConfig)
        flown = MpcConfig.build(began).flattened() if began else config.flattened()
        self._adopted = {
            spec.name
            for spec in config.specs()
            if spec.live and config.flattened()[spec.name] == flown.get(spec.name)
        }
        self._due = deque(run.changes)
        self._published_ns = {
            sent.value.stamp_ns: sent.publish_time_ns for sent in reversed(run.commands)
        }

    def before(self, event: _Event) -> MpcConfig | None:
        """Return the configuration in force at an event, if it is new then."""
        if not self._due:
            return None
        odometry = event.odometry
        published_ns = self._published_ns.get(
            event.now_ns if odometry is None else odometry.value.stamp_ns,
            event.now_ns if odometry is None else odometry.publish_time_ns,
        )
        changes: dict[str, Any] = {}
        while self._due and self._due[0].publish_time_ns <= published_ns:
            changes |= self._due.popleft().value
        adopted = {name: changes[name] for name in changes.keys() & self._adopted}
        if not adopted:
            return None
        self._config = self._config.updated(adopted)
        return self._config


def _events(run: RecordedRun, config: MpcConfig, windows: WindowSource | None) -> Iterator[_Event]:
    if windows is not None:
        return _at_stamps(run, windows, again=True)
    if config.lockstep:
        return _at_stamps(run, _first_by_stamp(run.windows).get, again=False)
    return _in_real_time(run, config)


def _at_stamps(
    run: RecordedRun, window_of: Callable[[int], ReferenceWindow | None], *, again: bool
) -> Iterator[_Event]:
    """Give each odometry the window of its stamp, at that time.

    In lockstep the controller waits for it, and ignores what is sent ``again``.
    """
    answered: set[int] = set()
    for odometry in run.odometries:
        stamp_ns = odometry.value.stamp_ns
        if again or stamp_ns not in answered:
            answered.add(stamp_ns)
            window = window_of(stamp_ns)
            yield _Event(now_ns=stamp_ns, odometry=odometry, window=window, window_ns=stamp_ns)


def _in_real_time(run: RecordedRun, config: MpcConfig) -> Iterator[_Event]:
    """Give each odometry the window that the controller had, when it had it.

    The recorder receives messages at other times than the controller, and some that it missed.
    But the figures of each tick say when it began, which window it had and when that had arrived.
    At the recorded control rate only answered odometries are given. Without a tick the time is the
    odometry's stamp and the window the last recorded before.
    """
    ticks = {stats.stamp_ns: stats for stats in run.stats}
    stamps = {odometry.value.stamp_ns for odometry in run.odometries}
    watched = sorted(ticks.keys() - stamps, reverse=True)
    windows = _Windows(run.windows)
    answered_only = bool(ticks) and _recorded_rate(run) == config.control_rate

    def unseen(stamp_ns: int) -> _Event:
        tick = ticks[stamp_ns]
        received_ns = stamp_ns - round(1e6 * tick.reference_age_ms)
        window = windows.of_stamp(tick.reference_stamp_ns, received_ns=received_ns)
        return _Event(now_ns=stamp_ns, window=window, window_ns=received_ns)

    for odometry in run.odometries:
        stamp_ns = odometry.value.stamp_ns
        tick = ticks.get(stamp_ns)
        if tick is None and answered_only:
            continue
        # Ages were whole nanoseconds before they became ms.
        now_ns = window_ns = stamp_ns + (round(1e6 * tick.odom_age_ms) if tick else 0)
        while watched and watched[-1] < now_ns:
            yield unseen(watched.pop())
        if tick is None:
            window = windows.before(odometry.log_time_ns)
        else:
            window_ns -= round(1e6 * tick.reference_age_ms)
            window = windows.of_stamp(tick.reference_stamp_ns, received_ns=window_ns)
            if window is None and tick.reference_stamp_ns:  # another reference, or not recorded
                window = windows.before(odometry.log_time_ns)
        yield _Event(
            now_ns=now_ns,
            odometry=odometry,
            window=window,
            window_ns=window_ns,
            answered=tick is not None,
        )


def _recorded_rate(run: RecordedRun) -> float:
    recorded = recorded_parameters(run.parameters, MpcConfig)
    return float(recorded.get("control_rate", MpcConfig().control_rate))


class _Windows:
    """The recorded windows, by when the controller received them."""

    def __init__(self, windows: Sequence[Received[ReferenceWindow]]) -> None:
        self._windows = windows
        self._recorded_ns = [window.log_time_ns for window in windows]
        self._places: dict[int, list[int]] = {}  # by stamp
        for place, window in enumerate(windows):
            self._places.setdefault(window.value.stamp_ns, []).append(place)

    def before(self, log_time_ns: int) -> ReferenceWindow | None:
        """Return the last window recorded by a time."""
        count = bisect.bisect_right(self._recorded_ns, log_time_ns)
        return self._windows[count - 1].value if count else None

    def of_stamp(self, stamp_ns: int, *, received_ns: int) -> ReferenceWindow | None:
        """Return the window of a stamp; of several, the last published by its reception."""
        alike = [self._windows[place] for place in self._places.get(stamp_ns, [])]
        before = [window for window in alike if window.publish_time_ns <= received_ns]
        found = before[-1:] or alike[:1]
        return found[0].value if found else None


def _first_by_stamp(recorded: Sequence[Received[S]]) -> dict[int, S]:
    """Return values by stamp; of what was sent again, the first."""
    first: dict[int, S] = {}
    for received in recorded:
        first.setdefault(received.value.stamp_ns, received.value)
    return first
