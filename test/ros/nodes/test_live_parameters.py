# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that are hammered in flight: whole transactions, and a solver that stays warm."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data

from quad_mpc_ros.messages.conversions import nanoseconds
from quad_mpc_ros.messages.diagnostics import stats_from_message

Start = Callable[..., "subprocess.Popen[bytes]"]

# In each the throttle and the rate of yaw that the feed makes the controller ask for are at their
# bounds: a tick that saw a part of a transaction would show the one of this with that of another.
TRANSACTIONS = [
    {"throttle_max": 0.5 + 0.1 * k, "omega_max": [1.0, 1.0, 0.5 + 0.25 * k]} for k in range(4)
]
WRONG = {"throttle_max": 0.55, "omega_max": [-1.0, 1.0, 1.0]}
REFUSAL = "mpc.omega_max: given [-1.0, 1.0, 1.0], expected 3 numbers > 0"


def _request(transaction: dict[str, Any]) -> SetParametersAtomically.Request:
    return SetParametersAtomically.Request(
        parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in transaction.items()
        ]
    )


def _shown(command: tuple[float, float]) -> int | None:
    """Return which transaction a command of throttle and rate shows, to the solver's tolerance."""
    for k, transaction in enumerate(TRANSACTIONS):
        bounds = (transaction["throttle_max"], transaction["omega_max"][2])
        if np.allclose(command, bounds, rtol=0.0, atol=0.02):
            return k
    return None


def test_commands_use_whole_parameter_transactions(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    """The requests come as fast as the node answers, from another process and at any moment."""
    commands: list[TwistStamped] = []
    stats: list[dict[str, str]] = []
    peer.node.create_subscription(
        TwistStamped, "command", commands.append, qos_profile_sensor_data
    )
    peer.node.create_subscription(
        DiagnosticArray, "mpc/stats", lambda m: stats.append(stats_from_message(m)), 10
    )
    feed.yaw, feed.height = 2.0, 0.0  # two metres below the reference, whatever the throttle
    at_once = ("rate_time_constant:=0.0", "thrust_time_constant:=0.0", "input_delay:=0.0")
    hard = ("Q:=[10,10,10,1,1,1,1,1,1]", "R:=[0.0,0.001,0.001,0.001]", "limits.tilt_max:=0.0")
    given = ("estimate_disturbance:=false", "consistency.action:=warn", *at_once, *hard)
    start("mpc", *(word for each in given for word in ("-p", each)))
    mpc = managed("mpc")
    assert mpc.set(**TRANSACTIONS[0]) == ""
    client = peer.node.create_client(SetParametersAtomically, "mpc/set_parameters_atomically")
    assert peer.wait(lambda: commands and client.service_is_ready())
    commands.clear()
    stats.clear()
    accepted, order = 0, random.Random(1)
    while len(commands) < 60 or accepted < 160:
        # In another order each time: ticks come after the last of a burst more often than not.
        burst = order.sample([*TRANSACTIONS, WRONG], len(TRANSACTIONS) + 1)
        sent = [(each, client.call_async(_request(each))) for each in burst]
        assert peer.wait(lambda sent=sent: all(future.done() for _, future in sent))
        for transaction, future in sent:
            result = future.result().result
            accepted += result.successful
            assert result.successful == (transaction is not WRONG)
            assert result.reason == ("" if result.successful else REFUSAL)
    peer.spin(0.1)
    by_mpc = {int(each["stamp_ns"]) for each in stats if each["source"] == "mpc"}
    seen = {
        (c.twist.linear.z, abs(c.twist.angular.z))
        for c in commands
        if nanoseconds(c.header.stamp) in by_mpc
    }
    assert len(by_mpc) > 30
    shown = {_shown(command) for command in seen}
    assert None not in shown, seen
    assert len(shown) > 1
