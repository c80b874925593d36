"""From a configuration to the trajectory that it asks for, judged against the vehicle's limits."""

from __future__ import annotations

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.feasibility import Verdict, judged
from quad_mpc_ros.trajectories.flat_trajectory import FlatTrajectory
from quad_mpc_ros.trajectories.path import Path
from quad_mpc_ros.trajectories.point_table import BagReader, bag_path
from quad_mpc_ros.trajectories.time_scaling import quickest
from quad_mpc_ros.trajectories.trajectory import Trajectory


def configured_trajectory(
    config: ReferenceConfig, *, read_bag: BagReader | None = None
) -> Trajectory:
    """Return the trajectory that a configuration asks for, slowed down if it says so.

    Raises :class:`UserError` for input that gives no trajectory, and for a smooth one that the
    vehicle cannot fly, with where and by how much. One that jumps is feasible for no vehicle and
    not refused: it is there to test controllers.
    """
    return _approved(*judged_trajectory(config, read_bag=read_bag), config)


def joined_trajectory(config: ReferenceConfig, *, read_bag: BagReader | None = None) -> Trajectory:
    """Return the same trajectory with legs of minimum snap in place of its jumps.

    Raises as :func:`configured_trajectory`.
    """
    joined = config.entry().joined
    if joined is None:
        return configured_trajectory(config, read_bag=read_bag)
    return _approved(*_judged(joined(config), config), config)


def judged_trajectory(
    config: ReferenceConfig, *, read_bag: BagReader | None = None
) -> tuple[Trajectory, Verdict]:
    """Return the configured trajectory with the verdict on it, also when it is not feasible."""
    if config.trajectory == "bag":
        return _judged(bag_path(config, read_bag), config)
    return _judged(config.entry().make(config), config)


def _judged(made: Path | Trajectory, config: ReferenceConfig) -> tuple[Trajectory, Verdict]:
    if isinstance(made, Trajectory):
        return made, _verdict(made, config)
    if config.time_scaling == "auto" and config.entry().scalable:
        return quickest(made, lambda path: _feasible(path, config)) or _flown(made, config)
    return _flown(made, config)


def _feasible(path: Path, config: ReferenceConfig) -> tuple[Trajectory, Verdict] | None:
    try:
        trajectory, verdict = _flown(path, config)
    except ConfigurationError:  # free fall
        return None
    return (trajectory, verdict) if verdict.feasible else None


def _flown(path: Path, config: ReferenceConfig) -> tuple[Trajectory, Verdict]:
    try:
        trajectory = FlatTrajectory(path, gravity=config.gravity, drag=config.drag, yaw=config.yaw)
    except ValueError as error:
        raise _refusal(config, str(error)) from error
    return trajectory, _verdict(trajectory, config)


def _verdict(trajectory: Trajectory, config: ReferenceConfig) -> Verdict:
    return judged(trajectory, config.vehicle(), config.limits())


def _approved(trajectory: Trajectory, verdict: Verdict, config: ReferenceConfig) -> Trajectory:
    if trajectory.smooth and not verdict.feasible:
        raise _refusal(config, verdict.reason())
    return trajectory


def _refusal(config: ReferenceConfig, reason: str) -> ConfigurationError:
    """Return the error of a trajectory that the vehicle cannot fly, with what to do."""
    if not config.entry().scalable:
        advice = f"change the parameters of {config.trajectory}"
    elif config.time_scaling == "none":
        advice = "slow it down, or set time_scaling to auto"
    else:
        advice = "however slow"
    return ConfigurationError(
        f"{config.owner}.trajectory",
        config.trajectory,
        f"one within the vehicle's limits: {reason}; {advice}",
    )
