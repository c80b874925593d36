"""Check that a bridge's thrust map can carry its vehicle."""

from __future__ import annotations

from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.thrust import ThrustMap
from quad_mpc_ros.ros.preflight.finding import Finding, error, warning

_MAX_HOVER_THROTTLE = 0.8  # of the stack's throttle, in hover
_REMEDY = "check thrust_map against mass and thrust_curve"


def thrust_map_findings(bridge: BridgeConfig) -> list[Finding]:
    """Return a finding if the stack's hover throttle is out of range or near the upper end."""
    kind, weight = bridge.thrust_map.kind, bridge.mass * bridge.gravity
    hover = ThrustMap(bridge).stack_throttle(bridge.vehicle().hover_throttle)
    if not 0.0 < hover < 1.0:
        return [
            error(
                f"thrust map ({kind}): given hover throttle {hover:g} for a weight of "
                f"{weight:.3g} N, expected 0 to 1",
                _REMEDY,
            )
        ]
    if hover > _MAX_HOVER_THROTTLE:
        return [
            warning(
                f"thrust map ({kind}): hover at the stack's throttle {hover:.2f}, expected "
                f"{_MAX_HOVER_THROTTLE:g} or less",
                _REMEDY,
            )
        ]
    return []
