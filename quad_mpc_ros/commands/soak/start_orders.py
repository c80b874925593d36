"""Starting the nodes in every order."""

from __future__ import annotations

import functools
import itertools

from quad_mpc_ros.commands.soak.rig import NODES, Rig, SoakError

_TIMEOUT = 60.0  # s
_FLYING = 0.3  # s


def start_in_every_order(rig: Rig) -> list[str]:
    """Start each node when the one before it is there, and return what went wrong."""
    wrong = []
    for order in itertools.permutations(NODES):
        try:
            _start(rig, order)
        except SoakError as error:
            wrong.append(f"{', '.join(order)}: {error}")
        for node in order:
            if node in rig.processes:
                rig.stop(node)
    rig.watch.forget()
    return [*wrong, *rig.watch.unsound]


def _start(rig: Rig, order: tuple[str, ...]) -> None:
    rig.wait(
        lambda: rig.node_names().isdisjoint(NODES),
        f"no node named {', '.join(NODES)} to be on this ROS domain",
        timeout=_TIMEOUT,
    )
    rig.watch.forget()
    for node in order:
        rig.start(node, **({"autostart": True} if node == "simulator" else {}))
        rig.wait(functools.partial(_is_there, rig, node), f"{node} to start", timeout=_TIMEOUT)
    rig.wait(lambda: rig.watch.source_for(_FLYING) == "mpc", "the MPC to fly")


def _is_there(rig: Rig, node: str) -> bool:
    return node in rig.node_names()
