# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly ArduPilot SITL in lockstep with the plant ``rotors``, with bridge, reference and MPC.

The tests check accuracy, settings, and the behaviour when a part fails.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures import ardupilot
from fixtures.ardupilot import SECOND, Pilot, flown

from quad_mpc_ros.ros.bridges.mavlink import codec
from quad_mpc_ros.ros.bridges.mavlink.autopilots import ARDUPILOT_MODES

pytestmark = pytest.mark.timeout(600)

EIGHT = {"trajectory": "lemniscate", "amplitude_x": 2.0, "amplitude_y": 1.0}
SQUARE = {"trajectory": "square", "dwell_time": 2.0}
CORNERS = {"corner 1": (1, -1), "corner 2": (1, 1), "corner 3": (-1, 1), "corner 4": (-1, -1)}
# What ``identify`` finds of the first flight below.
FOUND = {
    "rate_time_constant": (0.020, 0.035, 0.087),
    "torque_time_constant": (0.087, 0.097, 0.12),
    "rate_gain": (1.06, 1.01, 1.14),
    "thrust_time_constant": 0.029,
    "input_delay": 0.0,
}


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    """No installed ROS 2 is needed here."""


@pytest.fixture(autouse=True)
def _build() -> None:
    ardupilot.build()


def course(pilot: Pilot) -> None:
    """Fly from the ground to the ground, until it is disarmed."""
    pilot.engage_and_arm()
    pilot.take_off()
    pilot.live_for(20.0, "hover")
    pilot.fly("eight 1.0", 16.0, **EIGHT, angular_frequency=1.0)
    pilot.fly("eight 1.5", 14.0, **EIGHT, angular_frequency=1.5)
    pilot.fly("square", 14.0, **SQUARE)
    for corner, place in CORNERS.items():
        pilot.go_to(corner, 5.0, *place)
    assert pilot.land() < 15.0
    assert set(pilot.simulator.pulses[:4]) == {1000}
    assert {row.tick.stats.source for row in pilot.track.rows if row.phase != "ground"} <= {
        "mpc",
        "idle",
    }


def test_identified_parameters_reduce_the_tracking_error(tmp_path: Path) -> None:
    """The true state, for the errors to be those of MPC and bridge alone."""
    with flown(tmp_path / "guessed") as pilot:
        course(pilot)
        assert pilot.track.errors("hover", settled=2.0).max() < 0.02
        assert pilot.track.rms("eight 1.0", settled=5.0) < 0.05
        assert pilot.track.rms("eight 1.5", settled=5.0) < 0.05
        for corner in CORNERS:
            assert pilot.track.errors(corner, settled=4.0).max() < 0.05
        assert pilot.track.thrust_scale("eight 1.5") == pytest.approx(1.0, abs=0.05)
        found = pilot.identified()
    assert max(found.misfit) < 0.2
    assert found.thrust_scale.value == pytest.approx(1.0, abs=0.02)
    assert [each.value for each in found.drag] == pytest.approx([0.2, 0.2, 0.2], abs=0.02)
    assert found.input_delay.value == pytest.approx(FOUND["input_delay"], abs=0.012)
    gains = [each.value for each in found.rate_gain]
    assert gains == pytest.approx(list(FOUND["rate_gain"]), abs=0.05)
    with flown(tmp_path / "identified", mpc=FOUND) as pilot:
        course(pilot)
        for phase, most in (("hover", 0.01), ("eight 1.0", 0.01), ("eight 1.5", 0.025)):
            assert pilot.track.errors(phase, settled=5.0).max() < most


def test_flies_with_the_state_of_ardupilot(tmp_path: Path) -> None:
    with flown(tmp_path, truth=False) as pilot:
        course(pilot)
        for phase in ("hover", "eight 1.0", "eight 1.5", "square"):
            assert pilot.track.rms(phase, settled=5.0) < 0.1
        assert pilot.track.thrust_scale("eight 1.5") == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("parts", "most"),
    [({}, 0.03), ({"mpc": FOUND}, 0.035), ({"truth": False}, 0.05)],
    ids=["guessed", "identified", "its own state"],
)
def test_the_paper_square_settles_before_each_jump(
    tmp_path: Path, parts: dict[str, Any], most: float
) -> None:
    with flown(tmp_path, **parts) as pilot:
        pilot.engage_and_arm()
        pilot.take_off()
        pilot.fly_jumps("jumps", 11.0, **SQUARE)
        errors = pilot.track.errors_before_jumps("jumps")
        assert len(errors) == 5 and errors.max() < most
        assert pilot.land() < 15.0


@pytest.mark.parametrize("boost", [0, 1])
@pytest.mark.parametrize("expo", [0.0, 0.65])
def test_thrust_is_compensated_for_all_ardupilot_settings(
    tmp_path: Path, boost: int, expo: float
) -> None:
    settings = {"ATC_ANGLE_BOOST": boost, "MOT_THST_EXPO": expo}
    with flown(tmp_path, settings=settings) as pilot:
        pilot.engage_and_arm()
        pilot.take_off()
        pilot.fly("eight 1.5", 12.0, **EIGHT, angular_frequency=1.5)
        rows = pilot.track.of("eight 1.5")
        scales = [row.tick.stats.thrust_scale for row in rows]
        assert max(row.truth.up for row in rows) > 0.99 > 0.75 > min(row.truth.up for row in rows)
        assert min(scales) > 0.95 and max(scales) < 1.05
        assert pilot.track.rms("eight 1.5", settled=5.0) < 0.05


def test_hands_over_to_the_autopilot_and_back(tmp_path: Path) -> None:
    """The eleven handovers of ``tools/px4_handovers.py``, then a link that is cut."""
    with flown(tmp_path, truth=False) as pilot:
        pilot.engage_and_arm()
        pilot.take_off()

        pilot.fly("eight", 8.0, **EIGHT, angular_frequency=1.0)
        pilot.silent = True
        gone = pilot.until(lambda: not pilot.engaged, seconds=2.0, phase="MPC killed")
        assert gone == pytest.approx(0.5, abs=0.05)  # advanced.handover.release_after
        pilot.live_for(8.0)
        assert is_held_level(pilot)
        pilot.restart()
        pilot.live_for(8.0, "MPC started again, nothing asked")
        assert not pilot.engaged and is_held_level(pilot)

        taken_over(pilot, "engaged in the air")
        pilot.set_mode("BRAKE")
        quick = pilot.until(lambda: not pilot.engaged, seconds=1.0, phase="mode switched")
        assert quick < 0.15  # a heartbeat, ten times a second
        pilot.live_for(8.0)
        assert pilot.simulator.pulses[0] > 1100 and is_held_level(pilot)
        taken_over(pilot, "engaged again")
        assert pilot.land() < 20.0
        assert "disarms" in pilot.bridge.handover[1]

        pilot.live_for(2.0, "its own take-off")
        pilot.set_mode("GUIDED")
        pilot.live_for(1.0)
        pilot.say(codec.COMPONENT_ARM_DISARM, 1.0)
        pilot.live_for(2.0)
        pilot.say(22, 0, 0, 0, 0, 0, 0, 2.0)  # NAV_TAKEOFF
        pilot.live_for(10.0)
        assert not pilot.engaged and is_held_level(pilot)
        taken_over(pilot, "engaged after it")
        pilot.fly("lemniscate for 30 s", 30.0, **EIGHT, angular_frequency=1.0)

        pilot.cut = True
        pilot.live_for(3.0, "link cut")  # GUID_TIMEOUT is 0.5 s
        assert is_held_level(pilot)
        pilot.cut = False
        pilot.live_for(1.0, "link back")
        assert not pilot.engaged
        taken_over(pilot, "engaged after that")
        assert pilot.land() < 20.0
        tilts = {name: pilot.tilt(name) for name in dict.fromkeys(name for name, _ in pilot.tilts)}
        table = "\n".join(f"{name:34} {tilt:5.1f}" for name, tilt in tilts.items())
        # Without control the tilt stays as it was at the failure.
        began = {"MPC killed", "link cut"}
        assert max(tilt for name, tilt in tilts.items() if name not in began) < 20.0, table
        assert max(tilts[name] for name in began) < 35.0, table


def taken_over(pilot: Pilot, phase: str) -> None:
    pilot.phase = phase
    pilot.engage()
    pilot.live_for(8.0)
    assert pilot.engaged
    assert pilot.track.errors(phase, settled=4.0).max() < 0.1


def is_held_level(pilot: Pilot) -> bool:
    """Whether the vehicle is level and keeps its height; drift by wind is allowed."""
    leaning = float(np.degrees(np.arccos(min(pilot.plant.odometry(0).up, 1.0))))
    return leaning < 3.0 and abs(pilot.plant.v_WB_W[2]) < 0.1


@pytest.mark.parametrize("kind", ["attitude", "position"])
def test_detects_another_sender_of_commands(tmp_path: Path, kind: str) -> None:
    """The sender is on a link that the bridge does not receive; the bridge detects the target."""
    with flown(tmp_path, truth=False, links=2) as pilot:
        pilot.engage_and_arm()
        pilot.take_off()
        pilot.live_for(5.0, "hover")
        assert pilot.engaged
        other = codec.Codec(system=255)
        begin_ns = pilot.now_ns

        def rival() -> bool:
            if pilot.now_ns % (SECOND // 400 * 19) == 0:  # nearly 20 times a second
                pilot.simulator.link(1).sendall(other.packed(strange(kind)))
            return not pilot.engaged

        pilot.simulator.received(1)
        pilot.until(rival, seconds=3.0, phase="two")
        assert "another sender commands the vehicle" in pilot.bridge.handover[1]
        assert 1e-9 * (pilot.now_ns - begin_ns) < 2.0


def strange(kind: str) -> Any:
    mavlink = codec.dialect()
    if kind == "attitude":
        level = [1.0, 0.0, 0.0, 0.0]
        return mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0x80, level, 0, 0, 0, 0.37)
    numbers = (0.0, 0.0, -1.5, *(8 * [0.0]))
    return mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xDF8, *numbers)


def test_wrong_settings_are_refused_before_it_is_armed(tmp_path: Path) -> None:
    with flown(tmp_path, settings={"GUID_OPTIONS": 0}) as pilot:
        pilot.live_for(10.0)
        answer = pilot.bridge.engage(True, now_ns=pilot.now_ns)
        assert not answer.accepted and "set it to 8 (bit 3)" in answer.text
        assert ARDUPILOT_MODES["GUIDED_NOGPS"] != int(
            pilot.bridge._heartbeat.value(now_ns=pilot.now_ns).custom_mode
        )
