"""Planning a request in flight takes long and does not disturb the flight."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import joined_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

SECOND = 1_000_000_000
WINDOWS_NS = SECOND // 10  # from one to the next, as the node sends them
PLANNING_NS = 6 * SECOND // 10  # three times what a thousand points take
ASKED, ENDS = 7.0, 20.0  # s


def thousand_points() -> ReferenceWindow:
    """Return a ring of 2 m at 1 m/s, twice around, at a height of 2 m."""
    seconds = np.linspace(0.0, 25.0, 1000)
    points = np.column_stack((2.0 * np.cos(0.5 * seconds), 2.0 * np.sin(0.5 * seconds)))
    rest = np.zeros((1000, 3))
    return ReferenceWindow(
        stamp_ns=0,
        offset_ns=np.round(1e9 * seconds).astype(np.int64),
        p_WB=np.column_stack((points, np.full(1000, 2.0))),
        q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (1000, 1)),
        v_WB_W=rest,
        a_WB_W=rest,
        w_WB_W=rest,
    )


def test_accepts_long_trajectory_in_flight() -> None:
    """While it is planned no window comes at all, the worst that a busy node could do."""
    config = ReferenceConfig(mode="on_request", takeoff_height=2.0)
    live = LiveReference(
        config, joined_trajectory(config), joined=lambda: joined_trajectory(config)
    )
    simulator = SimulatorConfig(duration=ENDS)
    plant, controller = make_plant(simulator), warmed_up(MpcConfig())
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    took_off = False
    silent_until_ns, sent_ns = 0, 0
    errors: list[float] = []
    sources: set[Source] = set()
    while (sent := stream.step()) is not None:
        now_ns = SIMULATION_START_NS + sent.time_ns
        live.observe(sent.truth)
        if not took_off:
            took_off = live.take_off(now_ns).accepted
        if sent.time_ns == round(ASKED * SECOND):
            reply = live.follow(now_ns + PLANNING_NS, thousand_points())
            assert reply.accepted, reply.text
            silent_until_ns = now_ns + PLANNING_NS
        window = live.window(now_ns)
        assert window is not None
        if now_ns >= max(sent_ns + WINDOWS_NS, silent_until_ns):
            controller.receive_reference(window, now_ns=now_ns)
            sent_ns = now_ns
        for tick in (
            controller.receive_odometry(sent.odometry, now_ns=now_ns),
            controller.watch(now_ns=now_ns),
        ):
            if tick is not None and tick.command is not None:
                plant.apply(tick.command)
                sources.add(tick.decision.source)
        errors.append(float(np.linalg.norm(window.p_WB[0] - sent.truth.p_WB)))
    asked = round(ASKED * len(errors) / ENDS)
    assert sources == {Source.MPC}
    assert max(errors[asked:]) < max(errors[asked - 50 : asked]) + 0.05
    assert live.mode(SIMULATION_START_NS + round(ENDS * SECOND)) == "tracking"
