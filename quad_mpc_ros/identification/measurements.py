"""What an identification is fitted to: the motion, and the commands by the stamps they answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.vehicle import Vehicle
from quad_mpc_ros.recordings.recorded_run import Received, RecordedRun
from quad_mpc_ros.safety.validation import odometry_fault

# Perhaps on the ground: this near to where it stood, if it ever went this far from there [m].
_STANDING, _LEFT = 0.05, 0.3
_AT_REST = 0.3  # m/s
# After the first command the actuators are where nobody knows [s].
_SETTLING = 0.3
_STALE_COMMAND = 0.5  # s
_FASTEST = 1e3  # rad/s; nothing turns at more, and no throttle is larger
_FEWEST = 50


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements:
    """n odometries and m commands, in order of time [s], which starts with the first odometry.

    Shapes: ``p_WB``, ``v_WB_W``, ``w_WB_B`` (n, 3); ``R_WB`` (n, 3, 3); ``throttle`` (m,) in 0 to
    1; ``w_command`` (m, 3) [rad/s]. A command's time is the stamp of the odometry it answers.
    ``usable`` (n,) tells in which odometries the vehicle flies and acts on commands.
    ``command_age`` is the median time from that stamp to the command's publication [s], NaN where
    the clocks differ. ``vehicle`` is the one that the thrust is compared with.
    """

    time: Array
    p_WB: Array
    v_WB_W: Array
    R_WB: Array
    w_WB_B: Array
    command_time: Array
    throttle: Array
    w_command: Array
    usable: NDArray[np.bool_]
    command_age: float
    vehicle: Vehicle

    @property
    def period(self) -> float:
        """Usual time between two odometries [s]."""
        return float(np.median(np.diff(self.time)))


def measurements_of(run: RecordedRun, *, vehicle: Vehicle, twist_frame: str) -> Measurements:
    """Return what a recording tells of a vehicle whose twist is in ``child`` or ``world`` frame.

    Raises :class:`BagError` for one without commands, or with too little flight under them.
    """
    received = _in_order(run.odometries)
    odometries = [each.value for each in received]
    commands = _commands_in_order(run)
    if len(odometries) < _FEWEST:
        raise BagError(
            f"{run.bag}: {len(odometries)} usable odometries, expected {_FEWEST} or more"
        )
    if len(commands) < 2:
        raise BagError(
            f"{run.bag}: {len(commands)} commands, expected those of the flight, "
            "geometry_msgs/msg/TwistStamped with the throttle in linear.z, on a topic that ends "
            "in /command or on --command-topic"
        )
    start_ns = odometries[0].stamp_ns
    time = np.array([odometry.stamp_ns - start_ns for odometry in odometries]) * 1e-9
    R_WB = so3.rotation_from_quaternion_xyzw(np.array([o.q_WB_xyzw for o in odometries]))
    v, w = (np.array([getattr(o, name) for o in odometries]) for name in ("v_WB_B", "w_WB_B"))
    if twist_frame == "child":
        v = np.einsum("nij,nj->ni", R_WB, v)
    else:
        w = np.einsum("nji,nj->ni", R_WB, w)
    p_WB = np.array([odometry.p_WB for odometry in odometries])
    command_time = np.array([command.stamp_ns - start_ns for command in commands]) * 1e-9
    acting = _acting(run.engagements, np.array([each.log_time_ns for each in received]))
    usable = _flying(p_WB, v) & _commanded(time, command_time) & acting
    if np.count_nonzero(usable) < _FEWEST:
        raise BagError(
            f"{run.bag}: {np.count_nonzero(usable)} odometries of a flight under commands, "
            f"expected {_FEWEST} or more; the commands are stamped {command_time[0]:.3f} s to "
            f"{command_time[-1]:.3f} s after the first odometry, the odometries until "
            f"{time[-1]:.3f} s, and commands acted on {np.mean(acting):.0%} of them"
        )
    return Measurements(
        time=time,
        p_WB=p_WB,
        v_WB_W=v,
        R_WB=R_WB,
        w_WB_B=w,
        command_time=command_time,
        throttle=np.clip([command.throttle for command in commands], 0.0, 1.0),
        w_command=np.array([command.w_WB_B for command in commands]),
        usable=usable,
        command_age=_command_age(run),
        vehicle=vehicle,
    )


def _in_order(
    odometries: Sequence[Received[OdometrySample]],
) -> list[Received[OdometrySample]]:
    """Return what is fit for use in order of stamps, each stamp once."""
    first: dict[int, Received[OdometrySample]] = {}
    for received in odometries:
        odometry = received.value
        if odometry_fault(odometry, frame_id=odometry.frame_id) is None:
            first.setdefault(odometry.stamp_ns, received)
    return [first[stamp_ns] for stamp_ns in sorted(first)]


def _commands_in_order(run: RecordedRun) -> list[CommandSample]:
    first: dict[int, CommandSample] = {}
    for received in run.commands:
        command = received.value
        # NaN compares with nothing, and so is not within the limit.
        if np.all(np.abs([command.throttle, *command.w_WB_B]) <= _FASTEST):
            first.setdefault(command.stamp_ns, command)
    return [first[stamp_ns] for stamp_ns in sorted(first)]


def _flying(p_WB: Array, v_WB_W: Array) -> NDArray[np.bool_]:
    """Return when the vehicle is surely not on the ground.

    Where it stood still at the beginning or the end, and as near to there, it may have been: the
    ground holds what no model of flight explains. One that never leaves its place hovers.
    """
    flying = np.ones(len(p_WB), dtype=bool)
    for order in (slice(None), slice(None, None, -1)):
        distance = np.linalg.norm(p_WB[order] - p_WB[order][0], axis=1)
        left = int(np.argmax(distance > _LEFT))  # 0 when it never does
        if left and np.linalg.norm(v_WB_W[order][0]) < _AT_REST:
            stood = np.flatnonzero(distance[:left] <= _STANDING)[-1]
            flying[order][: stood + 1] = False
    return flying


def _commanded(time: Array, command_time: Array) -> NDArray[np.bool_]:
    """Return when a command is young enough to be followed, and the first one is history."""
    place = np.searchsorted(command_time, time, side="right") - 1
    age = time - command_time[np.maximum(place, 0)]
    return np.asarray((place >= 0) & (age < _STALE_COMMAND) & (time > command_time[0] + _SETTLING))


def _acting(
    engagements: Sequence[Received[bool]], recorded_ns: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return whether the vehicle acted on commands when each odometry was recorded [ns].

    And had done so for long enough; before it is said for the first time, it is supposed to.
    """
    acting = np.ones(len(recorded_ns), dtype=bool)
    acts = True
    for told in engagements:
        if told.value is not acts:
            acts = told.value
            acting[recorded_ns >= told.log_time_ns] = acts
            if acts:
                settled_ns = told.log_time_ns + _SETTLING * 1e9
                acting[(recorded_ns >= told.log_time_ns) & (recorded_ns < settled_ns)] = False
    return acting


def _command_age(run: RecordedRun) -> float:
    ages = [(sent.publish_time_ns - sent.value.stamp_ns) * 1e-9 for sent in run.commands]
    age = float(np.median(ages))
    return age if 0.0 <= age < 1.0 else float("nan")
