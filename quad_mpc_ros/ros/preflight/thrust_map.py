"""Whether a bridge's thrust map can carry its vehicle."""

from __future__ import annotations

from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.thrust import ThrustMap
from quad_mpc_ros.ros.preflight.finding import Finding, error, warning

_MAX_HOVER_THROTTLE = 0.8  # of the stack's throttle, in hover
_REMEDY = "check thrust_map against mass and thrust_curve"


def thrust_map_findings(bridge: BridgeConfig) -> list[Finding]:
    """Return whether the stack's throttle in hover is beyond its ends, or near the upper one."""
    kind, weight = bridge.thrust_map.kind, bridge.mass * bridge.gravity
    hover = ThrustMap(bridge).stack_throttle(bridge.vehicle().hover_throttle)
    if not 0.0 < hover < 1.0:
        return [
            error(
                f"the thrust map ({kind}) has no throttle that carries the weight of {weight:.3g} "
                f"N: it would be {hover:g}",
                _REMEDY,
            )
        ]
    if hover > _MAX_HOVER_THROTTLE:
        return [
            warning(
                f"by the thrust map ({kind}) it hovers at the stack's throttle {hover:.2f}, "
                f"expected {_MAX_HOVER_THROTTLE:g} or less",
                _REMEDY,
            )
        ]
    return []
