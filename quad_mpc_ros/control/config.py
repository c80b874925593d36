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
from quad_mpc_ros.control.model.vehicle import ActuatorLags, VehicleParameters

_live = functools.partial(parameter, live=True)
_advanced = functools.partial(parameter, advanced=True)
_live_advanced = functools.partial(_live, advanced=True)


@dataclass(frozen=True, kw_only=True)
class OdometryParameters(Configuration):
    """How to read the odometry."""

    owner = "mpc.odometry"

    frame_id: str = parameter("odom", doc="World frame that the odometry's header must name.")
    twist_frame: str = parameter(
        "child",
        doc="Frame of the odometry's twist: child (REP-103, body) or world.",
        choices=("child", "world"),
    )


@dataclass(frozen=True, kw_only=True)
class SolverParameters(Configuration):
    """Effort of OSQP; tolerances are those of the scaled problem, with variables of about 1."""

    owner = "mpc.solver"

    tolerance: float = _advanced(
        1e-3, doc="Absolute and relative tolerance of the scaled problem.", above=0.0, below=0.1
    )
    max_iterations: int = _advanced(
        1000, doc="Iterations until a solve counts as failed.", minimum=1
    )


_corner = functools.partial(_live, unit="m", length=3, minimum=-FARTHEST, maximum=FARTHEST)
_ACTIONS = ("warn", "hover", "stop")


@dataclass(frozen=True, kw_only=True)
class FenceParameters(BoxParameters):
    """A box in the world that the vehicle must not leave; by default it has no walls."""

    owner = "mpc.fence"

    minimum: tuple[float, ...] = _corner(
        NO_WALL[0], doc="Lowest position inside the fence; -1e7 is no wall."
    )
    maximum: tuple[float, ...] = _corner(
        NO_WALL[1], doc="Highest position inside the fence; 1e7 is no wall."
    )
    action: str = _live(
        "hover",
        doc="Outside of it: warn and fly on; hover inside of it without the solver, as soon as "
        "there is just room to stop; or stop publishing until the node is activated again.",
        choices=_ACTIONS,
    )


@dataclass(frozen=True, kw_only=True)
class EnvelopeParameters(Configuration):
    """Limits of tilt, body rates and speed; by default none."""

    owner = "mpc.envelope"

    tilt_max: float = _live(
        math.pi,
        doc="Largest angle between the thrust axis and up.",
        unit="rad",
        above=0.0,
        maximum=math.pi,
    )
    rate_max: float = _live(100.0, doc="Largest body rate, its norm.", unit="rad/s", above=0.0)
    speed_max: float = _live(100.0, doc="Largest speed.", unit="m/s", above=0.0)
    action: str = _live("warn", doc="Beyond it: as for fence.action.", choices=_ACTIONS)


@dataclass(frozen=True, kw_only=True)
class OscillationParameters(Configuration):
    """Detection of a limit cycle: the thrust axis swings from side to side repeatedly."""

    owner = "mpc.oscillation"

    tilt_amplitude: float = _live_advanced(
        0.2,
        doc="Angle to both sides of what the reference asks for, six changes of side within 3 s.",
        unit="rad",
        above=0.0,
        maximum=math.pi,
    )
    action: str = _live_advanced(
        "hover", doc="On oscillation: as for fence.action.", choices=_ACTIONS
    )
    hold_time: float = _live_advanced(
        10.0,
        doc="How long the action lasts; three times as long each time that it oscillates again.",
        unit="s",
        above=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class ConsistencyParameters(Configuration):
    """Action if the odometry contradicts itself or the commands."""

    owner = "mpc.consistency"

    action: str = _live(
        "descend",
        doc="If the odometry contradicts itself or the commands (frames, signs, units, thrust): "
        "warn and fly on; hover without the solver; descend level by dead reckoning for "
        "blind_time, then stop publishing; or stop publishing at once. The action lasts until the "
        "MPC is engaged again.",
        choices=("warn", "hover", "descend", "stop"),
    )


@dataclass(frozen=True, kw_only=True)
class SlewParameters(Configuration):
    """How fast a command may change; applied last, to every source, unknown to the plan."""

    owner = "mpc.slew"

    throttle: float = _live_advanced(
        0.0, doc="Largest change of the throttle; 0 is any.", unit="1/s", minimum=0.0
    )
    body_rates: float = _live_advanced(
        0.0, doc="Largest change of each body rate; 0 is any.", unit="rad/s^2", minimum=0.0
    )


_limit = functools.partial(_live, minimum=0.0, switch=True)
_advanced_limit = functools.partial(_limit, advanced=True)


@dataclass(frozen=True, kw_only=True)
class PlanLimitParameters(Configuration):
    """Soft limits inside the plan of ``manifold``; those at 0 are not in its problem at all.

    They bound what the controller adds to the reference, which may ask for more by itself.
    """

    owner = "mpc.limits"

    tilt_max: float = _limit(
        0.61,
        doc="manifold: largest angle between the thrust axis and up that is planned; 0 is any.",
        unit="rad",
        maximum=math.pi,
    )
    speed_max: float = _limit(0.0, doc="manifold: largest speed planned; 0 is any.", unit="m/s")
    throttle_margin: float = _advanced_limit(
        0.0,
        doc="manifold: distance to throttle_min and throttle_max that is kept for control; 0 is "
        "none.",
        below=0.5,
    )
    rate_slew: float = _advanced_limit(
        0.0,
        doc="manifold: largest change planned of each body rate commanded; 0 is any.",
        unit="rad/s^2",
    )
    pull_distance: float = _live_advanced(
        1.5,
        doc="manifold, with any of these limits: a reference further away than this, across or in "
        "height, pulls as if it were here. Sets the speed of an approach.",
        unit="m",
        above=0.0,
    )

    @property
    def in_use(self) -> list[str]:
        """The names of the active limits."""
        names = ("tilt_max", "speed_max", "throttle_margin", "rate_slew")
        return [name for name in names if getattr(self, name) > 0.0]


@dataclass(frozen=True, kw_only=True)
class ContouringParameters(Configuration):
    """Progress of ``contouring``, which slows down along the path before it leaves the path."""

    owner = "mpc.contouring"

    progress_weight: float = _live(
        10.0,
        doc="contouring: weight on the speed at which the reference's time passes, less 1. The "
        "less, the sooner time is given up for accuracy.",
        above=0.0,
    )
    speed_min: float = _live_advanced(
        0.2,
        doc="contouring: lowest speed at which the reference's time passes.",
        minimum=0.0,
        below=1.0,
    )
    speed_max: float = _live_advanced(
        1.05,
        doc="contouring: highest speed at which the reference's time passes.",
        minimum=1.0,
        maximum=2.0,
    )
    behind_max: float = _live_advanced(
        10.0,
        doc="contouring: how far the vehicle may be behind the reference's time.",
        unit="s",
        above=0.0,
        maximum=60.0,
    )


_keeping = functools.partial(_live_advanced, minimum=0.0)

GATE_HALF_SPACES = 8
"""Half-spaces on the position that hold the opening of a gate."""


@dataclass(frozen=True, kw_only=True)
class WorldParameters(Configuration):
    """Sources of obstacles."""

    file: str = parameter(
        "", doc="File of boxes, cylinders and spheres that stand, and of the volume of flight."
    )
    clouds: str = parameter(
        "scan",
        doc="What comes on obstacles: scans, which are forgotten after a time, or a map, each of "
        "which replaces the one before and stays.",
        choices=("scan", "map"),
    )
    forget_after: float = parameter(
        0.5, doc="How long a point of a scan is remembered.", unit="s", above=0.0, maximum=60.0
    )
    resolution: float = _advanced(
        0.1,
        doc="Side of the cubes of each of which one point of a cloud is kept.",
        unit="m",
        minimum=0.01,
        maximum=1.0,
    )
    neighbours: tuple[str, ...] = parameter(
        (),
        doc="Namespaces of other vehicles, whose mpc/predicted_path and odom are read.",
    )


@dataclass(frozen=True, kw_only=True)
class ObstacleParameters(WorldParameters):
    """Obstacle avoidance; without half-spaces the problem is unchanged."""

    owner = "mpc.obstacles"

    half_spaces: int = parameter(
        0,
        doc="manifold, contouring: maximum number of half-spaces for the position in each stage "
        "of the plan; 0 disables obstacle avoidance, 8 is enough for most scenes.",
        minimum=0,
        maximum=32,
    )
    margin: float = _live(
        0.1, doc="Distance kept beyond the vehicle's radius.", unit="m", minimum=0.0
    )
    margin_growth: float = _keeping(
        0.02,
        doc="What the margin grows by with the speed: for how long it is not known where the "
        "vehicle is, by an error of the delay or of the lags.",
        unit="s",
    )
    range: float = _live(
        8.0, doc="How far around the vehicle obstacles are regarded.", unit="m", above=0.0
    )
    acceleration: float = _live(
        5.0,
        doc="Acceleration of the ways around: how hard they brake, speed up and turn.",
        unit="m/s^2",
        above=0.0,
    )
    speed_max: float = _live(
        4.0,
        doc="Speed of the ways around, and of stopping in front; a faster reference may have its "
        "own.",
        unit="m/s",
        above=0.0,
    )
    downwash: float = _live_advanced(
        2.0,
        doc="How much further apart than sideways neighbours keep above each other.",
        minimum=1.0,
    )
    floor: float = _live(
        0.3, doc="Lowest height of the ways around; a lower reference may have its own.", unit="m"
    )


@dataclass(frozen=True, kw_only=True)
class RealtimeParameters(Configuration):
    """Settings of operating system and Python for real time."""

    owner = "mpc.realtime"

    scheduler_priority: int = _advanced(
        0, doc="Priority under SCHED_FIFO; 0 is the normal scheduler.", minimum=0, maximum=99
    )
    lock_memory: bool = _advanced(False, doc="Keep all memory of the process from being swapped.")
    garbage_collection: str = _advanced(
        "between_ticks",
        doc="When Python collects garbage: between ticks, or automatic, at any moment.",
        choices=("between_ticks", "automatic"),
    )


@dataclass(frozen=True, kw_only=True)
class MpcConfig(ManagedConfiguration, VehicleParameters):
    """Parameters of the MPC; those marked live may change in flight."""

    owner = "mpc"

    control_rate: float = parameter(
        50.0, doc="Commands per second; odometry is decimated to it.", unit="Hz", above=0.0
    )
    formulation: str = parameter(
        "manifold",
        doc="Model in the horizon: manifold, contouring (manifold, and progress along the "
        "reference gives way where the vehicle cannot follow), or paper (its Eq. 4).",
        choices=("manifold", "contouring", "paper"),
    )
    horizon_steps: int = parameter(12, doc="Steps N of the horizon.", minimum=1, maximum=200)
    horizon_step: float = parameter(
        0.08, doc="Time between two stages of the horizon.", unit="s", above=0.0
    )
    Q: tuple[float, ...] = _live(
        (10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.15, 0.15, 0.15),
        doc="Diagonal weight on the error of position, velocity, attitude.",
        length=9,
        minimum=0.0,
    )
    R: tuple[float, ...] = _live(
        (0.4, 0.05, 0.05, 0.05),
        doc="Diagonal weight on the error of throttle and body rates.",
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
        doc="manifold: lag of the body rates behind their command, one over the proportional gain "
        "of the vehicle's rate loop.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    torque_time_constant: float | tuple[float, ...] = parameter(
        0.02,
        doc="manifold: lag of the torque behind the rate loop, which rings if it is above "
        "rate_time_constant. 0: the rates lag by rate_time_constant alone, and the problem is "
        "smaller.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    angular_acceleration_max: float | tuple[float, ...] = parameter(
        0.0,
        doc="manifold: largest angular acceleration; 0 is no limit.",
        unit="rad/s^2",
        minimum=0.0,
    )
    rate_gain: float | tuple[float, ...] = parameter(
        1.0,
        doc="manifold: body rates in the long run over those commanded.",
        minimum=0.2,
        maximum=3.0,
    )
    thrust_time_constant: float = parameter(
        0.04,
        doc="manifold: first-order lag of the throttle behind its command.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    thrust_time_constant_down: float = parameter(
        0.0,
        doc="manifold: lag while the throttle decreases; 0 is thrust_time_constant.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    input_delay: float = parameter(
        0.02,
        doc="Time from the stamp of an odometry to when the command that answers it acts, the "
        "odometry's own delay included; the state is predicted across it, and across what an "
        "odometry comes later than the fastest.",
        unit="s",
        minimum=0.0,
        maximum=0.5,
    )
    estimate_disturbance: bool = parameter(
        True,
        doc="manifold: estimate an acceleration, the thrust's scale, the drag, the actuators' "
        "time constants where they lag and the bias of the measured velocity, and allow for them.",
    )
    disturbance_max: float = _live_advanced(
        5.0,
        doc="manifold: largest acceleration along the ground that the estimate may find; raise it "
        "where strong pushes are to be held.",
        unit="m/s^2",
        above=0.0,
        maximum=50.0,
    )
    accelerometer_noise: float = _advanced(
        0.0,
        doc="manifold: standard deviation that is assumed of what the accelerometer of the topic "
        "imu measures on the average from one odometry to the next, some four times its noise; "
        "0.5 is of use where the odometry's velocity is noisy, 0 is to listen to none.",
        unit="m/s^2",
        minimum=0.0,
        maximum=20.0,
    )
    lockstep: bool = parameter(
        False, doc="Answer each odometry with the reference of the same stamp, in simulated time."
    )
    odom_timeout: float = _live(
        0.1, doc="Odometry older than this is unusable.", unit="s", above=0.0
    )
    odom_gap: float = _live_advanced(
        0.4,
        doc="How long after the last odometry the MPC plans on, from where its own commands "
        "should have brought the vehicle; 0 is no longer than odom_timeout.",
        unit="s",
        minimum=0.0,
        maximum=1.0,
    )
    reference_timeout: float = _live(
        0.5,
        doc="A reference older than this is unusable, unless it still reaches over the horizon.",
        unit="s",
        above=0.0,
    )
    deadline: float = _advanced(
        0.8,
        doc="Share of a control period within which a plan has to be ready, or it is dropped; "
        "not in lockstep.",
        above=0.0,
        maximum=1.0,
    )
    plan_hold_time: float = _live(
        0.2, doc="How long the last plan is flown on when no new one comes.", unit="s", minimum=0.0
    )
    blind_time: float = _live(
        1.0,
        doc="How long to level and descend without odometry before falling silent.",
        unit="s",
        minimum=0.0,
    )
    odometry: OdometryParameters = dataclasses.field(default_factory=OdometryParameters)
    solver: SolverParameters = dataclasses.field(default_factory=SolverParameters)
    fence: FenceParameters = dataclasses.field(default_factory=FenceParameters)
    envelope: EnvelopeParameters = dataclasses.field(default_factory=EnvelopeParameters)
    oscillation: OscillationParameters = dataclasses.field(default_factory=OscillationParameters)
    consistency: ConsistencyParameters = dataclasses.field(default_factory=ConsistencyParameters)
    slew: SlewParameters = dataclasses.field(default_factory=SlewParameters)
    limits: PlanLimitParameters = dataclasses.field(default_factory=PlanLimitParameters)
    contouring: ContouringParameters = dataclasses.field(default_factory=ContouringParameters)
    gates: str = parameter(
        "",
        doc="contouring: file of the course whose openings are held by half-spaces, or its text "
        "in braces; none is to trust the reference.",
    )
    obstacles: ObstacleParameters = dataclasses.field(default_factory=ObstacleParameters)
    realtime: RealtimeParameters = dataclasses.field(default_factory=RealtimeParameters)

    @property
    def on_manifold(self) -> bool:
        """Whether the horizon has lags, estimates and limits: all formulations but ``paper``."""
        return self.formulation != "paper"

    @property
    def lags(self) -> ActuatorLags:
        """How throttle and body rates follow their commands."""
        return ActuatorLags(
            thrust=self.thrust_time_constant,
            thrust_down=self.thrust_time_constant_down,
            rate=self.rate_time_constant,
            torque=self.torque_time_constant,
            angular_acceleration_max=self.angular_acceleration_max,
        )

    @property
    def uses_accelerometer(self) -> bool:
        """Whether the estimator uses an accelerometer."""
        return self.accelerometer_noise > 0.0 and self.estimate_disturbance and self.on_manifold

    @property
    def holds_gates(self) -> bool:
        """Whether the openings of gates are held."""
        return self.formulation == "contouring" and bool(self.gates)

    @property
    def guided_by(self) -> str:
        """The parameter that requires a guide, else empty."""
        if self.obstacles.half_spaces > 0:
            return f"{self.owner}.obstacles.half_spaces"
        return f"{self.owner}.gates" if self.holds_gates else ""

    @property
    def half_spaces(self) -> int:
        """Number of half-spaces on the position in each stage of the plan."""
        return max(self.obstacles.half_spaces, GATE_HALF_SPACES if self.holds_gates else 0)

    @property
    def unmodelled_lags(self) -> list[str]:
        """The names of the lags that are zero, unlike those of any real vehicle."""
        if not self.on_manifold:
            return []
        names = ("rate_time_constant", "thrust_time_constant", "input_delay")
        return [name for name in names if min(per_axis(getattr(self, name))) == 0.0]

    @property
    def deadline_seconds(self) -> float:
        """Time within which a plan has to be ready [s]; infinite in lockstep."""
        return math.inf if self.lockstep else self.deadline / self.control_rate

    def check(self) -> None:
        """Refuse bounds that leave no throttle, and bounds that forbid hovering."""
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
        room = min(hover - self.throttle_min, self.throttle_max - hover)
        if not self.limits.throttle_margin < room:
            raise ConfigurationError(
                f"{self.owner}.advanced.limits.throttle_margin",
                self.limits.throttle_margin,
                f"a number below {room:.4f}, the distance of the hover throttle to its bounds",
            )
