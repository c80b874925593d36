# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state machine of the handover, and its use in every bridge."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.bridges import BRIDGES, HOVER, SECOND, T0, command, engage, ready_to_fly
from fixtures.windows import window_through
from hypothesis import given, settings
from hypothesis import strategies as st

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.ros.bridges.bridge import Bridge
from quad_mpc_ros.ros.bridges.config import HandoverParameters
from quad_mpc_ros.ros.bridges.handover import (
    Ground,
    Handover,
    HandoverConditions,
    HandoverState,
    Stack,
)

New = Callable[[str], Any]

READY = Stack(takes_setpoints=True, armed=True)
PERIOD = SECOND // 50
PLACE = np.array([1.0, 2.0, 3.0])


def advanced(handover: Handover, *stacks: Stack, blocker: str = "") -> Handover:
    """Let a stack speak, and commands come, one after the other."""
    for now_ns, stack in enumerate(stacks):
        handover.commanded(now_ns=now_ns)
        handover.advance(stack, blocker=blocker, now_ns=now_ns)
    return handover


def offered() -> Handover:
    handover = Handover(HandoverParameters())
    handover.offer(now_ns=0)
    return handover


def engaged() -> Handover:
    return advanced(offered(), READY)


def test_follows_the_documented_transitions() -> None:
    handover = offered()
    assert handover.state is HandoverState.OFFERED
    assert advanced(handover, Stack()).state is HandoverState.OFFERED
    assert advanced(handover, Stack(takes_setpoints=True)).state is HandoverState.STANDBY
    assert advanced(handover, READY).state is HandoverState.ENGAGED
    assert handover.reason == ""
    handover.release("released on request")
    assert handover.state is HandoverState.RELEASED


@pytest.mark.parametrize(
    ("stack", "reason"),
    [
        (Stack(armed=True, exit_reason="PX4 switched to hold"), "PX4 switched to hold"),
        (Stack(takes_setpoints=True), "disarming"),
        (Stack(fault="no status"), "no status"),
    ],
)
def test_takeover_releases_permanently(stack: Stack, reason: str) -> None:
    handover = advanced(engaged(), stack)
    assert handover.state is HandoverState.RELEASED
    assert reason in handover.reason
    assert advanced(handover, *[READY] * 1000).state is HandoverState.RELEASED


def test_names_the_missing_commands_when_the_stack_leaves_the_mode_after_a_gap() -> None:
    handover = engaged()
    stack = Stack(armed=True, exit_reason="PX4 switched to hold in a failsafe")
    handover.advance(stack, blocker="", now_ns=round(0.25 * SECOND))
    assert "no fresh command was received for 0.25 s, and PX4 switched to hold" in handover.reason


@pytest.mark.parametrize("away", [0.6, -0.6, 100.0])
def test_command_gap_releases(away: float) -> None:
    handover = engaged()
    handover.advance(READY, blocker="", now_ns=round(away * SECOND))
    assert handover.state is HandoverState.RELEASED
    assert "without a fresh command" in handover.reason


actions = st.lists(
    st.tuples(
        st.booleans(),  # a fresh command
        st.sampled_from([READY, Stack(), Stack(takes_setpoints=True), Stack(fault="mute")]),
        st.sampled_from(["", "too far"]),
        st.integers(0, 2 * SECOND),
    ),
    max_size=30,
)


@settings(deadline=None)
@given(actions)
def test_only_a_request_leaves_released(actions: list[Any]) -> None:
    handover, now_ns = offered(), 0
    for fresh, stack, blocker, elapsed_ns in actions:
        before, now_ns = handover.state, now_ns + elapsed_ns
        handover.advance(stack, blocker=blocker, now_ns=now_ns)
        if fresh:
            handover.commanded(now_ns=now_ns)
        if before is HandoverState.RELEASED:
            assert handover.state is HandoverState.RELEASED
        if handover.state is HandoverState.ENGAGED:
            assert stack == READY
        assert bool(handover.reason) is (handover.state is HandoverState.RELEASED)


def test_persistent_blocker_ends_the_offer_and_brief_one_does_not() -> None:
    handover = offered()
    for now_ns in range(0, SECOND, PERIOD):
        handover.commanded(now_ns=now_ns)
        flickers = "too far" if (now_ns // PERIOD) % 10 else ""
        handover.advance(Stack(takes_setpoints=True), blocker=flickers, now_ns=now_ns)
    assert handover.state is HandoverState.STANDBY
    for now_ns in range(SECOND, 2 * SECOND, PERIOD):
        handover.commanded(now_ns=now_ns)
        handover.advance(Stack(takes_setpoints=True), blocker="too far", now_ns=now_ns)
    assert "too far" in handover.reason


def test_on_ground_from_disarming_until_the_height_changes() -> None:
    ground = Ground()
    ground.update(PLACE, armed=True)
    assert ground.landed is False  # first seen armed: perhaps in the air
    ground.update(PLACE, armed=False)
    ground.update(PLACE, armed=True)
    assert ground.landed is True
    ground.update(PLACE + np.array([0.5, 0.0, 0.05]), armed=True)
    assert ground.landed is True
    ground.update(PLACE + np.array([0.0, 0.0, 0.3]), armed=True)
    ground.update(PLACE, armed=True)
    assert ground.landed is False


@dataclasses.dataclass
class Scene:
    """The state at the start of a handover; by default a hover at the reference."""

    tilt: float = 0.0
    away: tuple[float, float, float] = (0.0, 0.0, 0.0)
    share: float = 1.0
    w_WB_B: tuple[float, float, float] = (0.0, 0.0, 0.0)
    landed: bool | None = False
    rises: float = 0.0

    def blocker(self) -> str:
        surroundings = HandoverConditions()
        tilted = so3.quaternion_xyzw_from_rotation(so3.exp([self.tilt, 0.0, 0.0]))
        odometry = dataclasses.replace(
            OdometrySample.at_rest(PLACE, stamp_ns=T0), q_WB_xyzw=np.asarray(tilted)
        )
        surroundings.odometry.receive(odometry, T0)
        wanted = np.array([PLACE + self.away] * 3)
        wanted[1:, 2] += self.rises
        window = window_through([0.0, 1.0, 2.0], wanted, stamp_ns=T0)
        surroundings.reference.receive(window, T0)
        made = command(T0, w=self.w_WB_B)
        surroundings.command.receive((made, self.share), T0)
        return surroundings.blocker(landed=self.landed, now_ns=T0)


@pytest.mark.parametrize(
    "scene",
    [
        Scene(),
        Scene(tilt=0.3, share=1.2, w_WB_B=(1.0, 0.0, 0.0), away=(0.5, 0.0, 0.2)),
        Scene(landed=True, share=0.0, away=(0.0, 0.0, -5.0)),
        Scene(landed=None, share=0.0, away=(0.0, 0.0, -0.5)),
        Scene(landed=None),
    ],
)
def test_no_blocker_while_holding_near_the_reference(scene: Scene) -> None:
    assert scene.blocker() == ""


@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (Scene(tilt=math.radians(97.0)), "tilts by 97°"),
        (Scene(away=(15.0, 0.0, 0.0)), "15.00 m away"),
        (Scene(away=(0.0, 0.0, -1.5)), "1.50 m away"),
        (Scene(share=0.0), "0.00 of the weight"),
        (Scene(share=2.5), "2.50 of the weight"),
        (Scene(w_WB_B=(0.0, -16.0, 0.0)), "16.0 rad/s"),
        (Scene(landed=True), "of the weight as thrust"),
        (Scene(landed=True, share=0.0, rises=1.0), "the vehicle would take off at once"),
        (Scene(landed=True, share=0.0, away=(3.0, 0.0, -0.5)), "3.00 m away"),
        (Scene(landed=None, share=2.5), "of the weight as thrust"),
    ],
)
def test_refuses_handover_that_would_jump(scene: Scene, reason: str) -> None:
    assert reason in scene.blocker()


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_no_bridge_resumes_after_a_gap(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.receive_command(command(T0, HOVER), now_ns=T0)
    back = T0 + 2 * SECOND
    for now_ns in range(back, back + 3 * SECOND, PERIOD):
        assert bridge.receive_command(command(now_ns, HOVER), now_ns=now_ns) == []
        assert not bridge.engaged(now_ns=now_ns)
    assert "call the service engage" in bridge.silence
    later = back + 4 * SECOND
    assert engage(bridge, later).accepted
    assert bridge.receive_command(command(later, HOVER), now_ns=later)


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_no_bridge_hands_over_to_distant_reference(kind: type[Bridge], new: New) -> None:
    bridge = kind(kind.Config(), new)
    away = ReferenceWindow.hover([0.0, 0.0, 15.0], stamp_ns=T0)
    bridge.receive_reference(away, now_ns=T0)
    answer = engage(bridge, T0)
    assert not answer.accepted
    assert "15.00 m away" in answer.text
    assert bridge.receive_command(command(T0, HOVER), now_ns=T0) == []


@pytest.mark.parametrize("kind", BRIDGES.values(), ids=BRIDGES)
def test_every_bridge_releases_on_request(kind: type[Bridge], new: New) -> None:
    bridge = ready_to_fly(kind, T0)
    assert bridge.engage(False, now_ns=T0).accepted
    assert bridge.receive_command(command(T0, HOVER), now_ns=T0) == []
    assert "on request" in bridge.silence
