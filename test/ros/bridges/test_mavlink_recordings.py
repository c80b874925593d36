# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink recorded from real firmware in its simulation.

The recordings have a connection, a climb and a figure eight. Their motion must agree: positions
with velocities, attitudes with body rates, the direction of the thrust with the
acceleration. A wrong sign or axis breaks one of these.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import HOVER, command
from fixtures.stack_messages import new_message
from numpy.testing import assert_allclose

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.ros.bridges.mavlink import MavlinkBridge
from quad_mpc_ros.ros.bridges.mavlink.codec import Codec

FOLDER = Path(__file__).with_name("recordings")
# The least correlation, how far the slope may be from 1, and the drag of the body that flew [1/s].
# PX4's estimate of the vertical velocity differs from how its position moves, and 30 states a
# second are few.
RECORDINGS = {"ardupilot_4.6": (0.98, 0.1, 0.2), "px4_1.16": (0.95, 0.25, 1.0)}
UP = np.array([0.0, 0.0, 1.0])
CHUNK = 200  # bytes, as a line gives them


def replayed(name: str) -> tuple[MavlinkBridge, list[OdometrySample], list[str]]:
    """Return a bridge after a whole recording, with the vehicle's clock."""
    bridge = MavlinkBridge(MavlinkBridge.Config(), new_message)
    clock, now_ns = Codec(system=1), 0
    odometries: list[OdometrySample] = []
    warnings: list[str] = []
    data = (FOLDER / f"{name}.mavlink").read_bytes()
    for begin in range(0, len(data), CHUNK):
        piece = data[begin : begin + CHUNK]
        for message in clock.read(piece):
            if message.get_type() in ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"):
                now_ns = max(now_ns, 1_000_000 * message.time_boot_ms)
            elif message.get_type() == "ODOMETRY":
                now_ns = max(now_ns, 1_000 * message.time_usec)
        bridge.exchange(piece, now_ns=now_ns)
        odometries += [odometry for odometry, _ in bridge.take_odometries()]
        warnings += bridge.take_warnings()
    return bridge, odometries, warnings


def motion(odometries: list[OdometrySample]) -> dict[str, Any]:
    """Return times, and what is measured and what follows from differences in between."""
    time = np.array([each.stamp_ns for each in odometries]) * 1e-9
    p_WB = np.array([each.p_WB for each in odometries])
    R_WB = so3.rotation_from_quaternion_xyzw(np.array([each.q_WB_xyzw for each in odometries]))
    v_WB_W = np.einsum("nij,nj->ni", R_WB, np.array([each.v_WB_B for each in odometries]))
    w_WB_B = np.array([each.w_WB_B for each in odometries])
    step = np.diff(time)
    usual = (step > 0.005) & (step < 0.05)
    per = 1.0 / step[usual][:, None]
    turned = np.einsum("nji,njk->nik", R_WB[:-1], R_WB[1:])[usual]

    def mean(values: Any) -> Any:
        return 0.5 * (values[1:] + values[:-1])[usual]

    return {
        "v": mean(v_WB_W),
        "dp": np.diff(p_WB, axis=0)[usual] * per,
        "w": mean(w_WB_B),
        "dR": np.array([so3.log(R) for R in turned]) * per,
        "a": np.diff(v_WB_W, axis=0)[usual] * per,
        "thrust": mean(R_WB)[:, :, 2],
    }


@pytest.mark.parametrize("name", RECORDINGS)
def test_recorded_motion_is_consistent_about_every_axis(name: str) -> None:
    correlation, apart, drag = RECORDINGS[name]
    _, odometries, _ = replayed(name)
    assert len(odometries) > 80
    found = motion(odometries)
    for measured, differences, least in (("v", "dp", 0.3), ("w", "dR", 0.2)):
        ours, theirs = found[measured], found[differences]
        for axis in range(3):
            assert np.abs(ours[:, axis]).max() > least  # or it says nothing
            assert np.corrcoef(ours[:, axis], theirs[:, axis])[0, 1] > correlation, axis
            slope = np.polyfit(ours[:, axis], theirs[:, axis], 1)[0]
            assert slope == pytest.approx(1.0, abs=apart), axis
    force = found["a"] + 9.81 * UP + drag * found["v"]
    along = np.einsum("ni,ni->n", force, found["thrust"]) / np.linalg.norm(force, axis=1)
    assert np.median(along) > np.cos(np.radians(5.0))
    assert np.degrees(np.arccos(found["thrust"][:, 2].min())) > 25.0  # it leans


def test_replays_a_connection_to_ardupilot() -> None:
    bridge, odometries, warnings = replayed("ardupilot_4.6")
    now_ns = odometries[-1].stamp_ns
    assert bridge.landed(now_ns=now_ns) is False
    stack = bridge._stack(now_ns)
    assert (stack.armed, stack.takes_setpoints, stack.fault) == (True, True, "")
    assert not any("failsafe" in each for each in warnings)
    bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns)
    assert "tilts" in bridge.engage(True, now_ns=now_ns).text  # in the eight; else it would do
    settings = bridge._settings.values
    assert settings["GUID_OPTIONS"] == 8.0 and settings["ATC_ANGLE_BOOST"] == 0.0
    assert_allclose(
        [settings[f"MOT_{name}"] for name in ("THST_EXPO", "SPIN_MIN", "SPIN_MAX")],
        [0.65, 0.15, 0.95],
        atol=1e-6,
    )
