# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A bridge to your own flight stack, with a simulated stack. Requires no ROS.

A bridge receives the stack's messages and the time, fills the stack's messages, and rejects
invalid commands. Registered in setup.py (CONTRIBUTING.md, "Add a bridge"), the same class runs as
a node.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from quad_mpc_ros import CommandSample, Controller, MpcConfig, OdometrySample, ReferenceWindow
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import OutgoingMessage, Subscription, SwitchedBridge
from quad_mpc_ros.ros.bridges.config import BridgeConfig

STATE = Topic(name="toy/state", type_name="toy_msgs/msg/State")
RATES = Topic(name="toy/rates", type_name="toy_msgs/msg/Rates", reliable=True)


@dataclass(frozen=True, kw_only=True)
class ToyConfig(BridgeConfig):
    """Parameters of the bridge, without additions to those of all bridges."""

    owner = "toy_bridge"


class ToyBridge(SwitchedBridge):
    """Bridge to a stack with rates in degrees per second and thrust in newtons."""

    name, packages, Config = "toy_bridge", ("toy_msgs",), ToyConfig
    how_to_get = "it is a toy"
    publications = (RATES,)

    def __init__(self, config: ToyConfig, new: NewMessage) -> None:
        super().__init__(config, new)
        self.subscriptions = [Subscription(topic=STATE, receive=self._on_state)]

    def _on_state(self, message: Any, now_ns: int) -> OdometrySample | None:
        odometry = OdometrySample.at_rest(message.position_enu, stamp_ns=message.time_ns)
        return self._passed_on(odometry, now_ns=now_ns)

    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        message = self._new(RATES.type_name)
        message.rates_flu_deg = np.degrees(command.w_WB_B).tolist()
        message.thrust_newton = self.thrust.thrust_newton(command.throttle)
        return [OutgoingMessage(topic=RATES, message=message)]


bridge = ToyBridge(ToyConfig(), lambda type_name: SimpleNamespace())
controller = Controller(MpcConfig())
(state,) = bridge.subscriptions
sent = []
for now_ns in range(0, 100_000_000, 20_000_000):
    if now_ns == 40_000_000:
        print(bridge.engage(True, now_ns=now_ns).text)
    odometry = state.receive(SimpleNamespace(position_enu=[0, 0, 1], time_ns=now_ns), now_ns)
    assert odometry is not None
    tick = controller.step(odometry, ReferenceWindow.hover([0, 0, 1], stamp_ns=now_ns))
    assert tick is not None and tick.command is not None
    outgoing = bridge.receive_command(tick.command, now_ns=now_ns)
    messages = [each.message for each in outgoing if isinstance(each, OutgoingMessage)]
    sent += messages
    print(messages[0] if messages else f"silent: {bridge.silence}")

broken = SimpleNamespace(position_enu=[0, 0, float("nan")], time_ns=100_000_000)
refused = state.receive(broken, 100_000_000) is None
print(*bridge.take_warnings())
