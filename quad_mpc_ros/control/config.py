# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the MPC node."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

from quad_mpc_ros.configuration import (
    Configuration,
    ConfigurationError,
    ManagedConfiguration,
    parameter,
    per_axis,
)
from quad_mpc_ros.configuration.box import FARTHEST, NO_WALL, BoxParameters
from quad_mpc_ros.control.model.vehicle import (
    LATENCY_UNCERTAINTY,
    ActuatorLags,
    VehicleParameters,
)

MPC = "mpc"
"""Name of the MPC among the controllers."""
LEAST_RATE_WEIGHT = 0.001
"""Smallest weight of a body rate for a known rate loop, unless ``R`` is smaller."""

_live = functools.partial(parameter, live=True)
_advanced = functools.partial(parameter, advanced=True)
_live_advanced = functools.partial(_live, advanced=True)


@dataclass(frozen=True, kw_only=True)
class OdometryParameters(Configuration):
    """Interpretation of the odometry."""

    owner = "mpc.odometry"

    frame_id: str = parameter("odom", doc="World frame that the odometry's header must name.")
    twist_frame: str = parameter(
        "child",
        doc="Frame of the odometry's twist: child (REP-103, body) or world.",
        choices=("child", "world"),
    )


@dataclass(frozen=True, kw_only=True)
class SolverParameters(Configuration):
    """Effort of OSQP; tolerances apply to the scaled problem, with variables of about 1."""

    owner = "mpc.solver"

    tolerance: float = _advanced(
        1e-3, doc="Absolute and relative tolerance of the scaled problem.", above=0.0, below=0.1
    )
    max_iterations: int = _advanced(1000, doc="Iterations after which a solve fails.", minimum=1)


_corner = functools.partial(_live, unit="m", length=3, minimum=-FARTHEST, maximum=FARTHEST)
_ACTIONS = ("warn", "hover", "stop")


@dataclass(frozen=True, kw_only=True)
class FenceParameters(BoxParameters):
    """A box in the world that the vehicle must not leave; by default it has no walls."""

    owner = "mpc.fence"

    minimum: tuple[float, ...] = _corner(
        NO_WALL[0], doc="Lower corner of the fence; -1e7 is no wall."
    )
    maximum: tuple[float, ...] = _corner(
        NO_WALL[1], doc="Upper corner of the fence; 1e7 is no wall."
    )
    action: str = _live(
        "hover",
        doc="Action at the fence: warn and fly on; hover inside the fence without the solver, as "
        "soon as the stopping distance reaches a wall; or stop publishing until the node is "
        "activated again.",
        choices=_ACTIONS,
    )


@dataclass(frozen=True, kw_only=True)
class EnvelopeParameters(Configuration):
    """Limits of tilt, body rates and speed; by default unlimited."""

    owner = "mpc.envelope"

    tilt_max: float = _live(
        math.pi,
        doc="Largest angle between the thrust axis and up.",
        unit="rad",
        above=0.0,
        maximum=math.pi,
    )
    rate_max: float = _live(100.0, doc="Largest norm of the body rates.", unit="rad/s", above=0.0)
    speed_max: float = _live(100.0, doc="Largest speed.", unit="m/s", above=0.0)
    action: str = _live("warn", doc="Action beyond a limit, as fence.action.", choices=_ACTIONS)


@dataclass(frozen=True, kw_only=True)
class OscillationParameters(Configuration):
    """Detection of a limit cycle: the thrust axis swings from side to side repeatedly."""

    owner = "mpc.oscillation"

    action: str = _live_advanced(
        "hover",
        doc="Action on oscillation, as fence.action, for 3 s; tripled with each further "
        "oscillation.",
        choices=_ACTIONS,
    )


@dataclass(frozen=True, kw_only=True)
class ConsistencyParameters(Configuration):
    """Action if the odometry contradicts itself or the commands."""

    owner = "mpc.consistency"

    action: str = _live(
        "descend",
        doc="Action if the odometry contradicts itself or the commands (frames, signs, units, "
        "thrust): warn and fly on; hover without the solver; descend level by dead reckoning for "
        "blind_time, then stop publishing; or stop publishing at once. The action lasts until the "
        "MPC is engaged again.",
        choices=("warn", "hover", "descend", "stop"),
    )


_limit = functools.partial(_live, minimum=0.0, switch=True)


@dataclass(frozen=True, kw_only=True)
class PlanLimitParameters(Configuration):
    """Soft limits of the plan of ``manifold``; a limit of 0 is omitted from the problem.

    The limits bound deviations from the reference. The reference itself may exceed a limit.
    """

    owner = "mpc.limits"

    tilt_max: float = _limit(
        0.61,
        doc="manifold: largest planned angle between the thrust axis and up; 0 disables it.",
        unit="rad",
        maximum=math.pi,
    )
    speed_max: float = _limit(
        0.0, doc="manifold: largest planned speed; 0 disables it.", unit="m/s"
    )
    position_error_max: float = _live_advanced(
        1.5,
        doc="manifold, with any of these limits: bound on the position error in the cost, "
        "horizontal and vertical each. This bound sets the approach speed to a distant reference.",
        unit="m",
        above=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class ContouringParameters(Configuration):
    """Progress of ``contouring``, which slows down along the path before it leaves the path."""

    owner = "mpc.contouring"

    progress_weight: float = _live(
        10.0,
        doc="contouring: weight on the deviation of the progress speed from 1. With a smaller "
        "weight the vehicle slows down earlier to stay on the path.",
        above=0.0,
    )


GATE_HALF_SPACES = 8
"""Half-spaces on the position that hold the opening of a gate."""


@dataclass(frozen=True, kw_only=True)
class ObstacleParameters(Configuration):
    """Obstacle avoidance; without half-spaces the problem is unchanged."""

    owner = "mpc.obstacles"

    file: str = parameter(
        "", doc="File of static boxes, cylinders and spheres, and of the flight volume."
    )
    clouds: str = parameter(
        "scan",
        doc="Content of the topic obstacles: scans, which expire after forget_after, or maps, "
        "each of which replaces the previous map.",
        choices=("scan", "map"),
    )
    forget_after: float = parameter(
        0.5, doc="Time after which a point of a scan expires.", unit="s", above=0.0, maximum=60.0
    )
    resolution: float = _advanced(
        0.1,
        doc="Side length of the voxels; one point of a cloud is kept per voxel.",
        unit="m",
        minimum=0.01,
        maximum=1.0,
    )
    neighbours: tuple[str, ...] = parameter(
        (),
        doc="Namespaces of other vehicles to avoid, by their mpc/predicted_path and odom.",
    )
    half_spaces: int = parameter(
        0,
        doc="manifold, contouring: maximum number of half-spaces for the position in each stage "
        "of the plan; 0 disables obstacle avoidance, 8 is enough for most scenes.",
        minimum=0,
        maximum=32,
    )
    margin: float = _live(
        0.1,
        doc="Distance to obstacles in addition to the vehicle's radius.",
        unit="m",
        minimum=0.0,
    )
    margin_growth: float = _live_advanced(
        0.02,
        doc="Growth of the margin with the speed, for errors of the modelled delay and lags.",
        unit="s",
        minimum=0.0,
    )
    range: float = _live(
        8.0,
        doc="Distance from the vehicle within which obstacles are avoided.",
        unit="m",
        above=0.0,
    )
    acceleration: float = _live(
        5.0,
        doc="Largest acceleration of avoidance paths.",
        unit="m/s^2",
        above=0.0,
    )
    speed_max: float = _live(
        4.0,
        doc="Largest speed of avoidance paths and before stops; a faster reference keeps its "
        "speed.",
        unit="m/s",
        above=0.0,
    )
    downwash: float = _live_advanced(
        2.0,
        doc="Vertical distance between neighbours relative to the horizontal distance.",
        minimum=1.0,
    )
    floor: float = _live(
        0.3, doc="Lowest height of avoidance paths; a lower reference keeps its height.", unit="m"
    )


@dataclass(frozen=True, kw_only=True)
class MpcConfig(ManagedConfiguration, VehicleParameters):
    """Parameters of the MPC; those marked live may change in flight."""

    owner = "mpc"

    control_rate: float = parameter(
        50.0, doc="Control rate; faster odometry is decimated to it.", unit="Hz", above=0.0
    )
    controller: str = parameter(
        MPC,
        doc="Controller: mpc, geometric, px4, lqr, raptor, a name of another package, or "
        "module:Class. Input checks, limits and failsafe apply to every controller.",
    )
    formulation: str = parameter(
        "manifold",
        doc="Model in the horizon: manifold, contouring (manifold that slows down along the "
        "reference where the vehicle cannot follow), or paper (Eq. 4 of the paper, without rotor "
        "drag and lift).",
        choices=("manifold", "contouring", "paper"),
    )
    horizon_steps: int = parameter(
        12, doc="Number of stages N of the horizon.", minimum=1, maximum=200
    )
    horizon_step: float = parameter(
        0.08, doc="Duration of a stage of the horizon.", unit="s", above=0.0
    )
    Q: tuple[float, ...] = _live(
        (10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.15, 0.15, 0.15),
        doc="Diagonal weights of the errors of position, velocity and attitude.",
        length=9,
        minimum=0.0,
    )
    R: tuple[float, ...] = _live(
        (0.4, 0.05, 0.05, 0.05),
        doc="Diagonal weights of the errors of throttle and body rates.",
        length=4,
        minimum=0.0,
    )
    terminal_weight: float = _live(10.0, doc="Factor on Q at the last stage.", minimum=0.0)
    omega_max: tuple[float, ...] = _live(
        (6.0 * math.pi, 6.0 * math.pi, 3.0 * math.pi),
        doc="Bound on the body rates (roll, pitch, yaw).",
        unit="rad/s",
        length=3,
        above=0.0,
    )
    throttle_min: float = _live(0.0, doc="Lower bound on the throttle.", minimum=0.0, maximum=1.0)
    throttle_max: float = _live(1.0, doc="Upper bound on the throttle.", minimum=0.0, maximum=1.0)
    rate_time_constant: float | tuple[float, ...] = parameter(
        0.07,
        doc="manifold: time constant of the body rates, one over the proportional gain of the "
        "vehicle's rate loop.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    torque_time_constant: float | tuple[float, ...] = parameter(
        0.02,
        doc="manifold: time constant of the torque in the rate loop; the loop rings if it "
        "exceeds rate_time_constant. With 0 the rates have a first-order lag, and the problem is "
        "smaller.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    angular_acceleration_max: float | tuple[float, ...] = parameter(
        0.0,
        doc="manifold: largest angular acceleration of the rate loop; 0 disables the bound.",
        unit="rad/s^2",
        minimum=0.0,
    )
    rate_gain: float | tuple[float, ...] = parameter(
        1.0,
        doc="manifold: ratio of steady-state to commanded body rates.",
        minimum=0.2,
        maximum=3.0,
    )
    thrust_time_constant: float = parameter(
        0.04,
        doc="manifold: time constant of the throttle.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    thrust_time_constant_down: float = parameter(
        0.0,
        doc="manifold: time constant of a falling throttle; 0 is thrust_time_constant.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    input_delay: float = parameter(
        0.02,
        doc="Time from the stamp of an odometry until its command acts, including the delay of "
        "the odometry. The state is predicted over this time and over the extra latency of each "
        "odometry.",
        unit="s",
        minimum=0.0,
        maximum=0.5,
    )
    latency_uncertainty: float = parameter(
        LATENCY_UNCERTAINTY[1],
        doc="manifold: half width of the 95 % interval of the sum of rate_time_constant, "
        "torque_time_constant and input_delay, written by quad_mpc identify. R of the body rates "
        "is proportional to it at the start.",
        unit="s",
        minimum=LATENCY_UNCERTAINTY[0],
        maximum=LATENCY_UNCERTAINTY[1],
    )
    estimate_disturbance: bool = parameter(
        True,
        doc="manifold: estimate and compensate a disturbance acceleration, the thrust scale, the "
        "drag, the modelled time constants and the bias of the measured velocity.",
    )
    disturbance_max: float = _live_advanced(
        5.0,
        doc="manifold: largest horizontal disturbance acceleration that is estimated; increase it "
        "to withstand stronger forces.",
        unit="m/s^2",
        above=0.0,
        maximum=50.0,
    )
    accelerometer_noise: float = _advanced(
        0.0,
        doc="manifold: assumed standard deviation of the mean of the accelerometer (topic imu) "
        "between two odometries, about four times its noise. 0.5 helps with noisy odometry "
        "velocities; 0 disables the accelerometer.",
        unit="m/s^2",
        minimum=0.0,
        maximum=20.0,
    )
    lockstep: bool = parameter(
        False, doc="Answer each odometry using the reference of the same stamp, in simulated time."
    )
    odom_timeout: float = _live(
        0.1, doc="Age after which odometry is unusable.", unit="s", above=0.0
    )
    odom_gap: float = _live_advanced(
        0.4,
        doc="Time after the last odometry during which the MPC plans from a predicted state; 0 "
        "predicts until odom_timeout only.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    reference_timeout: float = _live(
        0.5,
        doc="Age after which a reference is unusable, unless its window still covers the horizon.",
        unit="s",
        above=0.0,
    )
    deadline: float = _advanced(
        0.8,
        doc="Longest computation of a plan as a share of a control period; later plans are "
        "dropped. Ignored in lockstep.",
        above=0.0,
        maximum=1.0,
    )
    plan_hold_time: float = _live(
        0.2, doc="Time for which the last plan is flown without a new plan.", unit="s", minimum=0.0
    )
    blind_time: float = _live(
        1.0,
        doc="Duration of the level descent without odometry; then publishing stops.",
        unit="s",
        minimum=0.0,
    )
    odometry: OdometryParameters = dataclasses.field(default_factory=OdometryParameters)
    solver: SolverParameters = dataclasses.field(default_factory=SolverParameters)
    fence: FenceParameters = dataclasses.field(default_factory=FenceParameters)
    envelope: EnvelopeParameters = dataclasses.field(default_factory=EnvelopeParameters)
    oscillation: OscillationParameters = dataclasses.field(default_factory=OscillationParameters)
    consistency: ConsistencyParameters = dataclasses.field(default_factory=ConsistencyParameters)
    limits: PlanLimitParameters = dataclasses.field(default_factory=PlanLimitParameters)
    contouring: ContouringParameters = dataclasses.field(default_factory=ContouringParameters)
    gates: str = parameter(
        "",
        doc="contouring: file of gates, or the content of the file in braces; half-spaces keep "
        "the plan inside the gate openings; an empty text disables the half-spaces.",
    )
    obstacles: ObstacleParameters = dataclasses.field(default_factory=ObstacleParameters)

    @property
    def on_manifold(self) -> bool:
        """Whether the horizon has lags, estimates and limits: all formulations but ``paper``."""
        return self.formulation != "paper"

    @property
    def lags(self) -> ActuatorLags:
        """Lags of throttle and body rates."""
        return ActuatorLags(
            thrust=self.thrust_time_constant,
            thrust_down=self.thrust_time_constant_down,
            rate=self.rate_time_constant,
            torque=self.torque_time_constant,
            angular_acceleration_max=self.angular_acceleration_max,
        )

    @property
    def rate_weight_scale(self) -> float:
        """Factor on ``R`` of the body rates before the lags are estimated in flight."""
        return self.latency_uncertainty / LATENCY_UNCERTAINTY[1] if self.on_manifold else 1.0

    @property
    def uses_accelerometer(self) -> bool:
        """Whether the estimator uses an accelerometer."""
        return self.accelerometer_noise > 0.0 and self.estimate_disturbance and self.on_manifold

    @property
    def holds_gates(self) -> bool:
        """Whether half-spaces keep the plan inside gate openings."""
        return self.formulation == "contouring" and bool(self.gates)

    @property
    def guided_by(self) -> str:
        """The parameter that requires a guide, empty without a guide."""
        if self.obstacles.half_spaces > 0:
            return f"{self.owner}.obstacles.half_spaces"
        return f"{self.owner}.gates" if self.holds_gates else ""

    @property
    def half_spaces(self) -> int:
        """Number of half-spaces on the position in each stage of the plan."""
        return max(self.obstacles.half_spaces, GATE_HALF_SPACES if self.holds_gates else 0)

    @property
    def unmodelled_lags(self) -> list[str]:
        """The names of the lags that are zero; on real vehicles no lag is zero."""
        if not self.on_manifold:
            return []
        names = ("rate_time_constant", "thrust_time_constant", "input_delay")
        return [name for name in names if min(per_axis(getattr(self, name))) == 0.0]

    @property
    def deadline_seconds(self) -> float:
        """Time within which a plan has to be ready [s]; infinite in lockstep."""
        return math.inf if self.lockstep else self.deadline / self.control_rate

    def check(self) -> None:
        """Reject bounds that leave no throttle, and bounds that forbid hovering."""
        super().check()
        hover = self.vehicle().hover_throttle
        if not self.throttle_min < hover < self.throttle_max:
            name = "throttle_min" if self.throttle_min >= hover else "throttle_max"
            side = "below" if name == "throttle_min" else "above"
            raise ConfigurationError(
                f"{self.owner}.{name}",
                getattr(self, name),
                f"a number {side} the hover throttle {hover:.4f}",
            )
        if self.obstacles.half_spaces > 0 and not self.on_manifold:
            raise ConfigurationError(
                f"{self.owner}.obstacles.half_spaces",
                self.obstacles.half_spaces,
                "0 with formulation paper, whose problem has no half-spaces",
            )
