"""What ``quad_mpc fly`` shows while it flies."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.commands.flight_monitor import FlightMonitor
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.messages import cdr

SECOND_NS = 1_000_000_000


def window(stamp_ns: int, x: float) -> bytes:
    rest = np.zeros((2, 3))
    held = ReferenceWindow(
        stamp_ns=stamp_ns,
        frame_id="odom",
        offset_ns=np.array([0, SECOND_NS]),
        p_WB=np.tile([x, 0.0, 2.0], (2, 1)),
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
        v_WB_W=rest,
        w_WB_W=rest,
        a_WB_W=rest,
    )
    return cdr.written_reference(held, child_frame_id="base_link")


def test_progress_compares_with_the_reference_of_the_last_odometry() -> None:
    """The reference moves on after the simulator has ended."""
    monitor = FlightMonitor(lockstep=False)
    odometry = OdometrySample.at_rest(np.array([0.1, 0.0, 2.0]))
    monitor._on_reference(window(odometry.stamp_ns, 0.0))
    monitor._on_odometry(cdr.written_odometry(odometry))
    monitor._on_reference(window(odometry.stamp_ns + 3 * SECOND_NS, 9.0))
    flown, error = monitor.progress()
    assert flown == 0.0
    assert error is not None
    np.testing.assert_allclose(error, 0.1)
