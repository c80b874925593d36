"""A flight with a fault in one process and in simulated time, as a node in real time flies it."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
from collections.abc import Callable
from typing import Generic

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.experiments.faults.cases import Fault, ProcessFault
from quad_mpc_ros.experiments.faults.distortions import Distortion, M
from quad_mpc_ros.experiments.faults.parameter_changes import good_and_bad_changes
from quad_mpc_ros.experiments.faults.solver import FaultySolver, SolverFault
from quad_mpc_ros.experiments.faults.verdict import Record, Sighting, command_fault, is_home
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.sensors import OdometryStream

_SECOND = 1_000_000_000
_STEP_NS = 5_000_000
_START_NS = 1_700_000_000 * _SECOND
# Of the beginning of the fault: just after an odometry, and just before the timer that watches.
_BEGIN_NS = 2_005_000_000
_DEADLINE = 0.04  # s, more than a busy computer takes for a plan
_AFTER_HOME_NS = 500_000_000  # of flight after the vehicle is back


class FaultFlight:
    """Plant, reference and controller, and between them the fault.

    References and odometries come at their rates, and a timer watches between two odometries.
    A command takes effect at once. Only the solver that runs long needs the wall clock. ``ticks``
    are all of the controller's with their times from the start of the flight [ns].
    """

    def __init__(
        self,
        fault: Fault,
        *,
        mpc: MpcConfig,
        simulator: SimulatorConfig,
        reference: ReferenceConfig,
    ) -> None:
        self._fault, self._config, self._simulator = fault, mpc, simulator
        self._end_ns = _BEGIN_NS + round(fault.duration * _SECOND)
        self._period_ns = round(_SECOND / mpc.control_rate)
        self._window_period_ns = round(_SECOND / reference.publish_rate)
        self._server = ReferenceServer(reference)
        self._server.start(_START_NS)
        runs_long = fault.solver is SolverFault.RUN_LONG
        self._controller = Controller(mpc, deadline=_DEADLINE if runs_long else math.inf)
        self._windows = Channel(fault.reference, self._receive_window)
        self._odometries = Channel(fault.odometry, self._receive_odometry)
        self._solver = FaultySolver()
        self._solver.long = 1.5 * _DEADLINE
        self._changes = good_and_bad_changes(mpc)

        self._time_ns = 0
        self.ticks: list[tuple[int, Tick]] = []
        self._unsound: list[str] = []
        self._home_ns: int | None = None
        self._start_plant()

    def run(self) -> Record:
        """Fly, let the fault happen, fly on until the vehicle is back; return what was seen."""
        with self._solver.installed():  # it sets itself up in the first solve
            self._fly_until(_BEGIN_NS)
        channel = self._odometries if self._fault.reference is None else self._windows
        origin_ns, counted = channel.passed_ns, self._count()
        self._solver.fault = self._fault.solver
        self._fly_until(self._end_ns)
        self._solver.fault = None
        if self._fault.process is ProcessFault.RESTART_SIMULATOR:
            self._start_plant()
        if self._fault.process is ProcessFault.PAUSE_MPC:
            self._wake_up()
        self._fly_home()
        return self._record(origin_ns, counted)

    def _start_plant(self) -> None:
        """Put a vehicle where the simulator's configuration says."""
        self._plant = make_plant(self._simulator)
        self._plant_started_ns = self._time_ns
        self._stream = OdometryStream(
            self._plant, self._simulator, start_stamp_ns=_START_NS + self._time_ns
        )

    def _wake_up(self) -> None:
        """Let a stopped process find its timer due, and one message on each topic."""
        self._windows.forget_all_but_last()
        self._odometries.forget_all_but_last()
        self._finish(self._controller.watch(now_ns=self._now_ns))

    def _fly_until(self, end_ns: int) -> None:
        while self._time_ns < end_ns:
            self._step()

    def _fly_home(self) -> None:
        """Fly until the vehicle has been back for a while, or should have been."""
        patience = self._fault.recovery(self._config) + self._fault.home
        deadline_ns = self._end_ns + round(patience * _SECOND)
        while self._time_ns < (self._home_ns or deadline_ns) + _AFTER_HOME_NS:
            self._step()

    def _step(self) -> None:
        """Do what is due now, and advance the time."""
        process = self._fault.process if self._active else None
        if process is ProcessFault.SET_PARAMETERS and self._time_ns % self._period_ns == 0:
            self._set_parameters()
        if self._time_ns % self._window_period_ns == 0:
            self._send_window()
        if process is not ProcessFault.RESTART_SIMULATOR:
            self._send_odometries()
        if process is not ProcessFault.PAUSE_MPC:
            self._windows.deliver(self._time_ns)
            self._odometries.deliver(self._time_ns)
            if self._time_ns % self._period_ns == self._period_ns // 2:
                self._finish(self._controller.watch(now_ns=self._now_ns))
        self._time_ns += _STEP_NS

    def _send_window(self) -> None:
        window = self._server.window(_START_NS + self._time_ns)
        if self._time_ns >= self._end_ns:
            self._look_for_home(window)
        stamped = dataclasses.replace(window, stamp_ns=self._now_ns + self._clock_ns)
        self._windows.send(stamped, time_ns=self._time_ns, elapsed_ns=self._elapsed_ns)

    def _send_odometries(self) -> None:
        for sent in self._stream.advance_to(self._time_ns - self._plant_started_ns):
            stamp_ns = sent.odometry.stamp_ns + self._clock_ns
            stamped = dataclasses.replace(sent.odometry, stamp_ns=stamp_ns)
            self._odometries.send(stamped, time_ns=self._time_ns, elapsed_ns=self._elapsed_ns)

    def _receive_window(self, window: ReferenceWindow) -> None:
        self._finish(self._controller.receive_reference(window, now_ns=self._now_ns))

    def _receive_odometry(self, odometry: OdometrySample) -> None:
        self._finish(self._controller.receive_odometry(odometry, now_ns=self._now_ns))

    def _finish(self, tick: Tick | None) -> None:
        """Apply the command, and keep what is judged later."""
        if tick is None:
            return
        self.ticks.append((self._time_ns, tick))
        if tick.command is not None:
            fault = command_fault(tick.command, self._config)
            if fault is not None:
                self._unsound.append(fault)
            self._plant.apply(tick.command)

    def _set_parameters(self) -> None:
        change = next(self._changes)
        try:
            config = self._config.updated(change.values)
        except ConfigurationError as error:
            if change.good:
                self._unsound.append(f"refused: {error}")
            return
        if not change.good:
            self._unsound.append(f"accepted: {dict(change.values)}")
        self._controller.reconfigure(config)
        self._config = config

    def _look_for_home(self, window: ReferenceWindow) -> None:
        error = float(np.linalg.norm(window.p_WB[0] - self._plant.odometry(0).p_WB))
        if not is_home(error):
            self._home_ns = None
        elif self._home_ns is None:
            self._home_ns = self._time_ns

    def _record(self, origin_ns: int, counted: int | None) -> Record:
        def since(time_ns: int) -> float:
            return (time_ns - origin_ns) / _SECOND

        return Record(
            sightings=[
                Sighting(time=since(time_ns), source=tick.stats.source, reason=tick.stats.reason)
                for time_ns, tick in self.ticks
            ],
            commands=[since(time_ns) for time_ns, tick in self.ticks if tick.command is not None],
            end=since(self._end_ns),
            over=since(self._end_ns),
            home=None if self._home_ns is None else since(self._home_ns),
            unsound=self._unsound,
            counted=None if counted is None else (self._count() or 0) - counted,
        )

    def _count(self) -> int | None:
        """Return the fault's counter; None when it has none, or no tick has it."""
        stats = dict(self.ticks[-1][1].stats.items())
        return int(stats[self._fault.counter]) if self._fault.counter in stats else None

    @property
    def _active(self) -> bool:
        return _BEGIN_NS <= self._time_ns < self._end_ns

    @property
    def _elapsed_ns(self) -> int | None:
        return self._time_ns - _BEGIN_NS if self._active else None

    @property
    def _clock_ns(self) -> int:
        return round(self._fault.clock * _SECOND) if self._active else 0

    @property
    def _now_ns(self) -> int:
        """The time of the controller, which a clock that is set does not move."""
        return _START_NS + self._time_ns


class Channel(Generic[M]):
    """A topic on its way to the controller: delivered at once, or as a distortion says.

    Times are in nanoseconds.
    """

    def __init__(self, distortion: Distortion[M] | None, receive: Callable[[M], None]) -> None:
        self._distortion: Distortion[M] | None = distortion
        self._receive: Callable[[M], None] = receive
        self._before: M | None = None
        self._waiting: list[tuple[int, int, M]] = []
        self._order = itertools.count()
        self.passed_ns = 0
        """When the last message was sent that no fault touched."""

    def send(self, message: M, *, time_ns: int, elapsed_ns: int | None) -> None:
        """Take a message; ``elapsed_ns`` is the time since a fault began, None without one."""
        if self._distortion is None or self._before is None or elapsed_ns is None:
            self._before, self.passed_ns = message, time_ns
            self._wait(message, time_ns)
            return
        for delivery in self._distortion(message, self._before, elapsed_ns):
            self._wait(delivery.message, time_ns + delivery.delay_ns)

    def deliver(self, time_ns: int) -> None:
        """Deliver what is due."""
        while self._waiting and self._waiting[0][0] <= time_ns:
            self._receive(heapq.heappop(self._waiting)[-1])

    def forget_all_but_last(self) -> None:
        """Keep the last waiting message, as the queue of a topic does for a stopped process."""
        self._waiting = self._waiting and [max(self._waiting)]

    def _wait(self, message: M, arrival_ns: int) -> None:
        heapq.heappush(self._waiting, (arrival_ns, next(self._order), message))
