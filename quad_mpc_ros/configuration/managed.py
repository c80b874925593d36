"""What the nodes with a lifecycle have in common."""

from __future__ import annotations

from dataclasses import dataclass

from quad_mpc_ros.configuration.fields import Configuration, parameter


@dataclass(frozen=True, kw_only=True)
class ManagedConfiguration(Configuration):
    """Parameters of a node that can be configured, activated, deactivated and cleaned up."""

    autostart: bool = parameter(
        True,
        doc="Configure and activate by itself at the start, as soon as what it needs is there; "
        "false waits for the transitions of the lifecycle.",
    )
