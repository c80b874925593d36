"""What the tests of the analysis share: flights made by hand, and bags made by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from quad_mpc_ros.analysis import CommandTrack, Flight, ReferenceTrack
from quad_mpc_ros.bags import BagWriter, RosbagsMessages
from quad_mpc_ros.bags.run_parameters import write_parameters
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.stats import TickStats
from quad_mpc_ros.core.messages import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.ros import conversions

START_NS = 1_700_000_000_000_000_000
MILLISECOND = 1_000_000
PERIOD_NS = 20 * MILLISECOND

FlightMaker = Callable[..., Flight]


@pytest.fixture
def make_flight() -> FlightMaker:
    """Return a maker of flights at 50 Hz that hover level at the origin, as the reference says.

    Every odometry is answered by a command 1 ms later, and the solver takes 25 iterations. The
    arguments are the number of odometries and any field of :class:`Flight` to replace.
    """

    def make(count: int = 100, **changes: Any) -> Flight:
        stamp_ns = START_NS + PERIOD_NS * np.arange(count)
        flight = Flight(
            stamp_ns=stamp_ns,
            publish_time_ns=stamp_ns,
            p_WB=np.zeros((count, 3)),
            q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            v_WB_B=np.zeros((count, 3)),
            w_WB_B=np.zeros((count, 3)),
            reference=reference_track(np.zeros((count, 3))),
            commands=command_track(stamp_ns, latency_ms=1.0),
            stats=stats([tick(int(stamp)) for stamp in stamp_ns]),
            parameters={},
            mpc=MpcConfig(),
        )
        return dataclasses.replace(flight, **changes)

    return make


def reference_track(p_WB: np.ndarray) -> ReferenceTrack:
    """Return a level reference at rest at the positions (n, 3)."""
    return ReferenceTrack(
        p_WB=p_WB,
        R_WB=np.tile(np.eye(3), (len(p_WB), 1, 1)),
        v_WB_B=np.zeros_like(p_WB),
        w_WB_B=np.zeros_like(p_WB),
        throttle=np.full(len(p_WB), 0.2923),
    )


def command_track(
    stamp_ns: np.ndarray, *, latency_ms: Any = 0.0, w_WB_B: np.ndarray | None = None
) -> CommandTrack:
    """Return hover commands that answer odometries published at their stamps."""
    return CommandTrack(
        stamp_ns=stamp_ns,
        publish_time_ns=stamp_ns + np.round(np.asarray(latency_ms) * MILLISECOND).astype(np.int64),
        throttle=np.full(len(stamp_ns), 0.2923),
        w_WB_B=np.zeros((len(stamp_ns), 3)) if w_WB_B is None else w_WB_B,
    )


def tick(stamp_ns: int, **changes: Any) -> TickStats:
    """Return the figures of a tick at which all is well."""
    return dataclasses.replace(
        TickStats(
            stamp_ns=stamp_ns,
            source="mpc",
            reason="",
            solver_status="solved",
            iterations=25,
            primal_residual=1e-5,
            dual_residual=1e-5,
            solve_time_us=100.0,
            step_time_us=400.0,
            odom_age_ms=0.1,
            reference_age_ms=5.0,
            commands=1,
            fallbacks=0,
            solver_failures=0,
            rejected_inputs=0,
        ),
        **changes,
    )


def stats(ticks: list[TickStats]) -> dict[str, np.ndarray]:
    """Return the columns of the figures of ticks, typed as in :class:`TickStats`."""
    dtypes = {"int": np.int64, "float": np.float64, "str": np.str_}
    return {
        field.name: np.array([getattr(one, field.name) for one in ticks], dtypes[str(field.type)])
        for field in dataclasses.fields(TickStats)
    }


def odometry(stamp_ns: int, **changes: Any) -> OdometrySample:
    """Return an odometry at rest at the origin, heading east."""
    return dataclasses.replace(
        OdometrySample(
            stamp_ns=stamp_ns,
            p_WB=np.zeros(3),
            q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
            v_WB_B=np.zeros(3),
            w_WB_B=np.zeros(3),
        ),
        **changes,
    )


def held_window(stamp_ns: int, place: list[float], **changes: Any) -> ReferenceWindow:
    """Return a window that holds a position for 2 s, level, heading east."""
    rest = np.zeros((2, 3))
    return dataclasses.replace(
        ReferenceWindow(
            stamp_ns=stamp_ns,
            offset_ns=np.array([0, 2_000_000_000]),
            p_WB=np.array([place, place]),
            q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
            v_WB_W=rest,
            a_WB_W=rest,
            w_WB_W=rest,
        ),
        **changes,
    )


class BagMaker:
    """Writes a bag message by message, all under one namespace."""

    def __init__(self, directory: Path, namespace: str) -> None:
        self.writer = BagWriter(directory)
        self._messages = RosbagsMessages()
        self._namespace = namespace
        self._topics: set[str] = set()

    def odometry(self, sample: OdometrySample, *, latency_ms: float = 0.0) -> None:
        """Write an odometry, published some time after its stamp."""
        message = self._messages.new("nav_msgs/msg/Odometry")
        conversions.fill_odometry(message, sample)
        self.write("odom", "nav_msgs/msg/Odometry", message, sample.stamp_ns, latency_ms)

    def reference(self, window: ReferenceWindow) -> None:
        """Write a window."""
        kind = "trajectory_msgs/msg/MultiDOFJointTrajectory"
        message = self._messages.new(kind)
        conversions.fill_reference(
            message, window, child_frame_id="base_link", new=self._messages.new
        )
        self.write("reference", kind, message, window.stamp_ns)

    def command(self, sample: CommandSample, *, latency_ms: float = 0.0) -> None:
        """Write a command, published some time after its stamp."""
        message = self._messages.new("geometry_msgs/msg/TwistStamped")
        conversions.fill_command(message, sample)
        kind = "geometry_msgs/msg/TwistStamped"
        self.write("command", kind, message, sample.stamp_ns, latency_ms)

    def tick(self, figures: TickStats) -> None:
        """Write the figures of a tick."""
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        message = self._messages.new(kind)
        conversions.fill_stats(message, figures, new=self._messages.new)
        self.write("mpc/stats", kind, message, figures.stamp_ns)

    def empty(self, topic: str, kind: str, stamp_ns: int) -> None:
        """Write an empty message of any type."""
        self.write(topic, kind, self._messages.new(kind), stamp_ns)

    def parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Write the parameters of a node."""
        write_parameters(self.writer, node, values)

    def write(
        self, topic: str, kind: str, message: Any, stamp_ns: int, latency_ms: float = 0.0
    ) -> None:
        """Write a message; a topic with a leading slash is outside the namespace."""
        name = topic if topic.startswith("/") else f"{self._namespace}/{topic}"
        if name not in self._topics:
            self.writer.add_topic(name, kind)
            self._topics.add(name)
        time_ns = stamp_ns + round(latency_ms * MILLISECOND)
        data = self._messages.encode(kind, message)
        self.writer.write(name, data, log_time_ns=time_ns, publish_time_ns=time_ns)


@pytest.fixture
def build() -> SimpleNamespace:
    """Return the builders of this file, as tests cannot import it."""
    return SimpleNamespace(
        start_ns=START_NS,
        period_ns=PERIOD_NS,
        reference=reference_track,
        commands=command_track,
        tick=tick,
        stats=stats,
        odometry=odometry,
        window=held_window,
    )


@pytest.fixture
def make_bag(tmp_path: Path) -> Callable[..., BagMaker]:
    """Return a starter of bags; the caller closes ``writer``."""

    def make(name: str = "bag", *, namespace: str = "") -> BagMaker:
        return BagMaker(tmp_path / name, namespace)

    return make
