"""Parameters that are hammered in flight: whole transactions, and a solver that stays warm."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from typing import Any

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
WRONG = {"throttle_max": 0.55, "omega_max": [-1.0, 1.0, 1.0]}
REFUSAL = "mpc.omega_max: given [-1.0, 1.0, 1.0], expected 3 numbers > 0"


def _request(transaction: dict[str, Any]) -> SetParametersAtomically.Request:
    return SetParametersAtomically.Request(
        parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in transaction.items()
        ]
    )


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
    accepted = 0
    while len(commands) < 60 or accepted < 200:
        sent = [(each, client.call_async(_request(each))) for each in [*TRANSACTIONS, WRONG]]
        assert peer.wait(lambda sent=sent: all(future.done() for _, future in sent))
        for transaction, future in sent:
            result = future.result().result
            accepted += result.successful
            assert result.successful == (transaction is not WRONG)
            assert result.reason == ("" if result.successful else REFUSAL)
    whole = {(t["throttle_max"], t["omega_max"][2]) for t in TRANSACTIONS}
    seen = {(round(c.twist.linear.z, 3), round(abs(c.twist.angular.z), 3)) for c in commands}
    assert len(seen) > 1
    assert seen <= whole
