"""Names that parameters had before: refused with the new one, and understood in old recordings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.errors import ConfigurationError

_ADVANCED_OF_BRIDGES = ("clock_tolerance", "command_timeout", "mpc_command_topic")
_UNREAD_BY_BRIDGES = ("drag", "rotor_drag", "translational_lift", "torque_curve")
_PX4_MESSAGES = ("odometry", "status", "rates", "mode", "land", "command", "ack", "battery")

RENAMED: Mapping[str, Mapping[str, str]] = {
    "mpc": {
        "torque_curve": "",
        "deadline": "advanced.deadline",
        "disturbance_max": "advanced.disturbance_max",
        "odom_gap": "advanced.odom_gap",
        "limits.pull_distance": "advanced.limits.pull_distance",
        "limits.rate_slew": "advanced.limits.rate_slew",
        "limits.throttle_margin": "advanced.limits.throttle_margin",
        "realtime.cpus": "advanced.realtime.cpus",
        "realtime.garbage_collection": "advanced.realtime.garbage_collection",
        "realtime.keep_awake": "advanced.realtime.keep_awake",
        "realtime.lock_memory": "advanced.realtime.lock_memory",
        "realtime.scheduler_priority": "advanced.realtime.scheduler_priority",
        "slew.rate_max": "advanced.slew.body_rates",
        "slew.throttle_max": "advanced.slew.throttle",
        "solver.max_iterations": "advanced.solver.max_iterations",
        "solver.tolerance": "advanced.solver.tolerance",
        "swinging.action": "advanced.oscillation.action",
        "swinging.hold_time": "advanced.oscillation.hold_time",
        "swinging.tilt": "advanced.oscillation.tilt_amplitude",
    },
    "simulator": {
        "torque_curve": "",
        "integration_step": "advanced.integration_step",
        "lockstep_timeout": "advanced.lockstep_timeout",
    },
    "reference": {
        "torque_curve": "",
        "omega_max": "advanced.trajectory_omega_max",
        "path_tolerance": "advanced.path_tolerance",
        "publish_rate": "advanced.publish_rate",
        "reach": "advanced.reach",
        "throttle_max": "advanced.trajectory_throttle_max",
        "throttle_min": "advanced.trajectory_throttle_min",
        "window_duration": "advanced.window_duration",
        "window_step": "advanced.window_step",
    },
    "recorder": {
        "nodes": "advanced.nodes",
        "sync": "advanced.sync",
    },
    "visualisation": {
        **dict.fromkeys(_UNREAD_BY_BRIDGES, ""),
    },
    "bridge": {
        **dict.fromkeys(_UNREAD_BY_BRIDGES, ""),
        **{name: f"advanced.{name}" for name in _ADVANCED_OF_BRIDGES},
        "handover.distance_max": "advanced.handover.engage_distance_max",
        "handover.rate_max": "advanced.handover.engage_rate_max",
        "handover.release_after": "advanced.handover.release_after",
        "handover.tilt_max": "advanced.handover.engage_tilt_max",
    },
    "px4_bridge": {f"{kind}_version": f"advanced.{kind}_version" for kind in _PX4_MESSAGES},
}
"""The present name by node and former name, empty for what nothing read; ``bridge`` is of all."""


class RenamedError(ConfigurationError):
    """A parameter by its former name."""

    def __init__(self, former: str, now: str) -> None:
        super().__init__(former, None, now)
        self.args = (
            f"{former} was renamed {now}"
            if now
            else f"{former} was removed: nothing read it; leave it out",
        )


def refuse_former_name(owner: str, name: str) -> None:
    """Raise :class:`RenamedError` for a name that a parameter of a node had before."""
    now = _names(owner).get(name)
    if now is not None:
        raise RenamedError(f"{owner}.{name}", f"{owner}.{now}" if now else "")


def with_present_names(owner: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return recorded parameters of a node by their present names, without removed ones."""
    names = _names(owner)
    present = {names.get(name, name): value for name, value in values.items()}
    present.pop("", None)
    return present


def _names(owner: str) -> Mapping[str, str]:
    shared = RENAMED["bridge"] if owner.endswith("_bridge") else {}
    return {**shared, **RENAMED.get(owner, {})}
