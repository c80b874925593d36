# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Feed a recorded flight to a controller and compute its commands.

The controller always receives the recorded odometry, and the recorded commands count as sent. With
the flight's configuration the commands equal the recorded commands, bit for bit, if the
controller's inputs and their times were recorded.
"""

from __future__ import annotations

import bisect
import dataclasses
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import (
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.recordings.logs import Received
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.recordings.run import RecordedRun

WindowSource = Callable[[int], ReferenceWindow]
"""Returns the reference window of a stamp [ns], instead of the recorded window."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Resolved:
    """The result of the controller; ``odometry`` is None if the watchdog acted.

    ``now_ns`` is the controller's time. ``window`` is the newest received window.
    """

    now_ns: int
    odometry: Received[OdometrySample] | None
    window: ReferenceWindow | None
    tick: Tick | None

    @property
    def log_time_ns(self) -> int:
        """Record time of the odometry [ns]; without an odometry the controller's time."""
        return self.now_ns if self.odometry is None else self.odometry.log_time_ns


def resolve(
    run: RecordedRun,
    config: MpcConfig,
    *,
    windows: WindowSource | None = None,
    warn: Callable[[str], None] = lambda text: None,
) -> Iterator[Resolved]:
    """Yield every odometry of a recorded flight with the controller's result.

    Live parameters set in flight are set again, except parameters of ``config`` that differ from
    the values at the start of the flight. ``windows`` replaces the recorded reference. ``warn``
    receives the log lines of the controller.
    """
    if config.uses_accelerometer and config.lockstep and not run.imu:
        warn("no imu in the recording: accelerometer_noise is ignored")
        config = dataclasses.replace(config, accelerometer_noise=0.0)
    controller = Controller(config)
    sent = {each.value.stamp_ns: each.value for each in reversed(run.commands)}  # the first wins
    window: ReferenceWindow | None = None
    engagements, landings = deque(run.engagements), deque(run.landings)
    resets = deque(run.resets)
    imu_until, command_time = _imu_until(run), _command_times(run)
    live_configs = _live_configs(run, config)

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
        while live_configs and live_configs[0].publish_time_ns <= command_time(event):
            controller.reconfigure(live_configs.popleft().value)
        if event.odometry is None:
            tick = controller.watch(now_ns=event.now_ns)
        else:
            for sample in imu_until(event.odometry.value.stamp_ns):
                controller.receive_imu(sample)
            controller.check_stamps(not event.answered)
            tick = controller.receive_odometry(event.odometry.value, now_ns=event.now_ns)
        for warning in controller.take_warnings():
            warn(warning)
        if tick is not None and tick.stats.stamp_ns in sent:
            controller.replace_last_command(sent[tick.stats.stamp_ns], now_ns=event.now_ns)
        yield Resolved(now_ns=event.now_ns, odometry=event.odometry, window=window, tick=tick)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Event:
    """An odometry, or the watchdog, with the active window and its reception time.

    An odometry that was ``answered`` had not been rejected.
    """

    now_ns: int
    odometry: Received[OdometrySample] | None = None
    window: ReferenceWindow | None = None
    window_ns: int = 0
    answered: bool = False


def _imu_until(run: RecordedRun) -> Callable[[int], Iterator[ImuSample]]:
    """Return a function of a stamp [ns] that yields the samples since the previous call.

    Samples end at the newest sample of the controller's tick according to its figures, or else at
    the stamp.
    """
    due = deque(received.value for received in run.imu)
    stats = [each.value for each in run.stats]
    had_ns = {each.stamp_ns: each.imu_stamp_ns for each in stats if each.imu_stamp_ns}

    def until(stamp_ns: int) -> Iterator[ImuSample]:
        while due and due[0].stamp_ns <= had_ns.get(stamp_ns, stamp_ns):
            yield due.popleft()

    return until


def _live_configs(run: RecordedRun, config: MpcConfig) -> deque[Received[MpcConfig]]:
    """Return the active configurations after each change in flight.

    Parameters of ``config`` that differ from the values at the start of the flight are kept.
    """
    began = recorded_parameters(run.parameters, MpcConfig)
    given = config.flattened()
    flown = MpcConfig.build(began).flattened() if began else given
    adopted = {s.name for s in config.specs() if s.live and given[s.name] == flown.get(s.name)}
    found: deque[Received[MpcConfig]] = deque()
    for change in run.changes:
        values = {name: value for name, value in change.value.items() if name in adopted}
        if values:
            config = config.updated(values)
            found.append(
                Received(
                    value=config,
                    log_time_ns=change.log_time_ns,
                    publish_time_ns=change.publish_time_ns,
                )
            )
    return found


def _command_times(run: RecordedRun) -> Callable[[_Event], int]:
    """Return a function of an event: publish time of its command, or else of its odometry [ns].

    One thread sets parameters and sends commands, so a change published before a command applied
    to it. Stamps do not define the order: in simulated time they are equal.
    """
    published_ns = {sent.value.stamp_ns: sent.publish_time_ns for sent in reversed(run.commands)}

    def of_event(event: _Event) -> int:
        odometry = event.odometry
        if odometry is None:
            return published_ns.get(event.now_ns, event.now_ns)
        return published_ns.get(odometry.value.stamp_ns, odometry.publish_time_ns)

    return of_event


def _events(run: RecordedRun, config: MpcConfig, windows: WindowSource | None) -> Iterator[_Event]:
    if windows is not None:
        return _at_stamps(run, windows, again=True)
    if config.lockstep:
        first = {each.value.stamp_ns: each.value for each in reversed(run.windows)}
        return _at_stamps(run, first.get, again=False)
    return _in_real_time(run, config)


def _at_stamps(
    run: RecordedRun, window_of: Callable[[int], ReferenceWindow | None], *, again: bool
) -> Iterator[_Event]:
    """Assign the window of its stamp to each odometry, at that time.

    In lockstep the controller waits for this window, and ignores messages sent ``again``.
    """
    answered: set[int] = set()
    for odometry in run.odometries:
        stamp_ns = odometry.value.stamp_ns
        if again or stamp_ns not in answered:
            answered.add(stamp_ns)
            window = window_of(stamp_ns)
            yield _Event(now_ns=stamp_ns, odometry=odometry, window=window, window_ns=stamp_ns)


def _in_real_time(run: RecordedRun, config: MpcConfig) -> Iterator[_Event]:
    """Assign the controller's window to each odometry, with its reception time.

    The recorder receives messages at other times than the controller, and possibly more messages.
    But the figures of each tick contain its start time, its window and the window's arrival time.
    At the recorded control rate only answered odometries are used. Without a tick the time is the
    odometry's stamp, and the window is the last recorded before.
    """
    ticks = {each.value.stamp_ns: each.value for each in run.stats}
    stamps = {odometry.value.stamp_ns for odometry in run.odometries}
    watched = sorted(ticks.keys() - stamps, reverse=True)
    windows = _Windows(run.windows)
    recorded = recorded_parameters(run.parameters, MpcConfig)
    rate = recorded.get("control_rate", MpcConfig().control_rate)
    answered_only = bool(ticks) and rate == config.control_rate

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


class _Windows:
    """The recorded windows, by reception time of the controller."""

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
        """Return the last window of a stamp that was published before its reception."""
        alike = [self._windows[place] for place in self._places.get(stamp_ns, [])]
        before = [window for window in alike if window.publish_time_ns <= received_ns]
        found = before[-1:] or alike[:1]
        return found[0].value if found else None
