"""A flight with a fault in one process and in simulated time, as a node in real time flies it."""

from __future__ import annotations

import dataclasses
import functools
import heapq
import itertools
from collections.abc import Callable

import numpy as np

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller, Tick
from quad_mpc_ros.core.messages import OdometrySample, ReferenceWindow
from quad_mpc_ros.faults.cases import Action, Fault
from quad_mpc_ros.faults.parameter_storm import Change, storm
from quad_mpc_ros.faults.solver import FaultySolver
from quad_mpc_ros.faults.verdict import Record, Sighting, command_fault, is_home
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.odometry_stream import OdometryStream
from quad_mpc_ros.simulation.plants import AnyPlant, make_plant

_SECOND = 1_000_000_000
_STEP_NS = 5_000_000
_START_NS = 1_700_000_000 * _SECOND
# s of flight before the fault, which begins just after an odometry and just before the timer
_SETTLED = 2.005
_AFTER_HOME = 0.5  # s of flight after the vehicle is back


class FaultFlight:
    """Plant, reference and controller, and between them the fault.

    References and odometries come at their rates, and a timer watches between two odometries.
    A command takes effect at once. Only the solver that runs long needs the wall clock.
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
        self._period_ns = round(_SECOND / mpc.control_rate)
        self._reference_period_ns = round(_SECOND / reference.publish_rate)
        self._solver = FaultySolver()
        self._solver.long = 1.5 / mpc.control_rate
        with self._solver.installed():
            self._controller = Controller(mpc)
            self._server = ReferenceServer(reference)
            self._server.start(_START_NS)
            self._begins_ns = round(_SETTLED * _SECOND)
            self._ends_ns = self._begins_ns + round(fault.duration * _SECOND)
            self._storm = storm(mpc)
            self._time_ns = self._origin_ns = 0
            self._waiting: list[tuple[int, int, Callable[[], None]]] = []
            self._order = itertools.count()
            self._odometry: OdometrySample | None = None
            self._window: ReferenceWindow | None = None
            self._kept: dict[str, Callable[[], None]] = {}
            self._ticks: list[tuple[int, Tick]] = []
            self._unsound: list[str] = []
            self._home_ns: int | None = None
            self._counted_before: int | None = None
            self._restart()
            # The solver sets itself up in the first solve.
            self._fly_until(self._begins_ns)

    def run(self) -> Record:
        """Fly through the fault until the vehicle is back and return what was seen."""
        self._counted_before = self._count()
        self._solver.fault = self._fault.solver
        self._fly_until(self._ends_ns)
        self._solver.fault = None
        if self._fault.action is Action.RESTART_SIMULATOR:
            self._restart()
        latest = self._fault.recovery(self._config) + self._fault.home
        self._fly_until(self._ends_ns + round((latest + _AFTER_HOME) * _SECOND), stop_at_home=True)
        return Record(
            sightings=[
                Sighting(
                    time=self._since_origin(time_ns),
                    source=tick.stats.source,
                    reason=tick.stats.reason,
                )
                for time_ns, tick in self._ticks
            ],
            commands=[
                self._since_origin(time_ns)
                for time_ns, tick in self._ticks
                if tick.command is not None
            ],
            end=self._since_origin(self._ends_ns),
            home=None if self._home_ns is None else self._since_origin(self._home_ns),
            unsound=self._unsound,
            counted=None if self._counted_before is None else self._counted(),
        )

    def _restart(self) -> None:
        """Put the vehicle where it starts."""
        self._plant: AnyPlant = make_plant(self._simulator)
        self._plant_started_ns = self._time_ns
        self._stream = OdometryStream(
            self._plant, self._simulator, start_stamp_ns=_START_NS + self._time_ns
        )

    def _fly_until(self, end_ns: int, *, stop_at_home: bool = False) -> None:
        while self._time_ns < end_ns:
            self._step()
            self._time_ns += _STEP_NS
            away = self._home_ns is None
            if stop_at_home and not away and self._since_home() > _AFTER_HOME:
                return

    def _step(self) -> None:
        if self._fault.action is Action.SET_PARAMETERS and self._active:
            self._set_parameters()
        if self._kept and not self._paused:
            self._resume()
        if self._time_ns % self._reference_period_ns == 0:
            window = self._server.window(_START_NS + self._time_ns)
            self._judge_position(window)
            self._send_reference(window)
        for sent in self._stream.advance_to(self._time_ns - self._plant_started_ns):
            self._send_odometry(sent.odometry)
        while self._waiting and self._waiting[0][0] <= self._time_ns:
            heapq.heappop(self._waiting)[-1]()
        if self._time_ns % self._period_ns == self._period_ns // 2 and not self._paused:
            self._finish(self._controller.watch(now_ns=self._now_ns))

    def _send_reference(self, window: ReferenceWindow) -> None:
        window = dataclasses.replace(window, stamp_ns=window.stamp_ns + self._clock_ns)
        before = self._window if self._window is not None else window
        if self._fault.reference is None or not self._active:
            if self._before and self._fault.reference is not None:
                self._origin_ns = self._time_ns
            self._window = window
            self._later(0, "reference", lambda: self._receive_reference(window))
            return
        for delivery in self._fault.reference(window, before, self._elapsed_ns):
            receive = functools.partial(self._receive_reference, delivery.message)
            self._later(delivery.delay_ns, "reference", receive)

    def _send_odometry(self, odometry: OdometrySample) -> None:
        if self._fault.action is Action.RESTART_SIMULATOR and self._active:
            return
        odometry = dataclasses.replace(odometry, stamp_ns=odometry.stamp_ns + self._clock_ns)
        before = self._odometry if self._odometry is not None else odometry
        if self._fault.odometry is None or not self._active:
            if self._before and self._fault.reference is None:
                self._origin_ns = self._time_ns
            self._odometry = odometry
            self._later(0, "odometry", lambda: self._receive_odometry(odometry))
            return
        for delivery in self._fault.odometry(odometry, before, self._elapsed_ns):
            receive = functools.partial(self._receive_odometry, delivery.message)
            self._later(delivery.delay_ns, "odometry", receive)

    def _later(self, delay_ns: int, topic: str, receive: Callable[[], None]) -> None:
        """Let a message arrive after a delay; of what comes to a paused process the last stays."""
        if self._paused:
            self._kept[topic] = receive
        else:
            arrival_ns = self._time_ns + delay_ns
            heapq.heappush(self._waiting, (arrival_ns, next(self._order), receive))

    def _resume(self) -> None:
        """Let a process that stood still find its timer due and a message on each topic."""
        self._finish(self._controller.watch(now_ns=self._now_ns))
        for receive in self._kept.values():
            receive()
        self._kept.clear()

    def _receive_reference(self, window: ReferenceWindow) -> None:
        self._finish(self._controller.receive_reference(window, now_ns=self._now_ns))

    def _receive_odometry(self, odometry: OdometrySample) -> None:
        self._finish(self._controller.receive_odometry(odometry, now_ns=self._now_ns))

    def _finish(self, tick: Tick | None) -> None:
        """Let the command act, and keep what is to be judged."""
        if tick is None:
            return
        self._ticks.append((self._time_ns, tick))
        if tick.command is not None:
            fault = command_fault(tick.command, self._config)
            if fault is not None:
                self._unsound.append(fault)
            self._plant.apply(tick.command)

    def _set_parameters(self) -> None:
        if self._time_ns % self._period_ns:
            return
        change: Change = next(self._storm)
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

    def _judge_position(self, window: ReferenceWindow) -> None:
        if self._time_ns < self._ends_ns:
            return
        error = float(np.linalg.norm(window.p_WB[0] - self._plant.state.p_WB))
        if not is_home(error):
            self._home_ns = None
        elif self._home_ns is None:
            self._home_ns = self._time_ns

    def _count(self) -> int | None:
        """Return the fault's counter; None when it has none, or when it is not told."""
        stats = dict(self._ticks[-1][1].stats.items()) if self._ticks else {}
        return int(stats[self._fault.counter]) if self._fault.counter in stats else None

    def _counted(self) -> int | None:
        after = self._count()
        return None if after is None else after - (self._counted_before or 0)

    def _since_origin(self, time_ns: int) -> float:
        return (time_ns - self._origin_ns) / _SECOND

    def _since_home(self) -> float:
        return 0.0 if self._home_ns is None else (self._time_ns - self._home_ns) / _SECOND

    @property
    def _before(self) -> bool:
        return self._time_ns < self._begins_ns

    @property
    def _active(self) -> bool:
        return self._begins_ns <= self._time_ns < self._ends_ns

    @property
    def _paused(self) -> bool:
        return self._fault.action is Action.PAUSE_MPC and self._active

    @property
    def _elapsed_ns(self) -> int:
        return self._time_ns - self._begins_ns

    @property
    def _clock_ns(self) -> int:
        return round(self._fault.clock * _SECOND) if self._active else 0

    @property
    def _now_ns(self) -> int:
        return _START_NS + self._time_ns + self._clock_ns
