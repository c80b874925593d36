"""Parameters that are hammered in flight: whole transactions, and a solver that stays warm."""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data

Start = Callable[..., "subprocess.Popen[bytes]"]

# In each the throttle and the rate of yaw that the feed makes the controller ask for are at their
# bounds: a tick that saw a part of a transaction would show the one of this with that of another.
TRANSACTIONS = [
    {"throttle_max": 0.5 + 0.1 * k, "omega_max": [1.0, 1.0, 0.5 + 0.25 * k]} for k in range(4)
]
SAME_AS_BEFORE = {"throttle_max": 0.55, "omega_max": [-1.0, 1.0, 1.0]}  # refused as a whole


def test_every_command_shows_a_whole_transaction(
    start: Start, peer: Any, feed: Any, managed: Any
) -> None:
    """The requests come as fast as the node answers, in another process and at any moment."""
    commands: list[TwistStamped] = []
    peer.node.create_subscription(
        TwistStamped, "command", commands.append, qos_profile_sensor_data
    )
    feed.yaw = 2.0
    start("mpc", "-p", "estimate_disturbance:=false", "-p", "Q:=[10,10,10,1,1,1,1,1,1]")
    mpc = managed("mpc")
    assert mpc.set(**TRANSACTIONS[0]) == ""
    assert peer.wait(lambda: commands)
    commands.clear()
    client = peer.node.create_client(SetParametersAtomically, "mpc/set_parameters_atomically")
    accepted = refused = 0
    for transaction in itertools.cycle([*TRANSACTIONS, SAME_AS_BEFORE]):
        request = SetParametersAtomically.Request()
        request.parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in transaction.items()
        ]
        result = peer.call(client, request).result
        accepted += result.successful
        refused += not result.successful
        if transaction is SAME_AS_BEFORE:
            assert "mpc.omega_max: given [-1.0, 1.0, 1.0], expected 3 numbers > 0" in result.reason
        if len(commands) >= 100:
            break
    assert accepted > 100
    assert refused > 20
    whole = {(t["throttle_max"], t["omega_max"][2]) for t in TRANSACTIONS}
    seen = {
        (round(c.twist.linear.z, 3), round(abs(c.twist.angular.z), 3)) for c in commands
    }
    assert len(seen) > 1
    assert seen <= whole
