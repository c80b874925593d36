# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Measurements for an identification: motion, and commands by the stamps that they answer."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import BagError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.control.model.voltage import SmoothedVoltage
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages.topics import BATTERY, COMMAND, ENGAGED
from quad_mpc_ros.recordings.flight import first_by_stamp
from quad_mpc_ros.recordings.logs import Log, Received, Stamps
from quad_mpc_ros.recordings.run import RecordedRun

RECORDED = (COMMAND, ENGAGED, BATTERY)
"""Topics that are read in addition to odometry."""

# Possibly on the ground: within the first distance of the start or end, if the vehicle ever went
# beyond the second one [m].
_GROUND_RADIUS, _LEFT_RADIUS = 0.05, 0.3
_REST_SPEED = 0.3  # m/s
# The state of the actuators is unknown for this time after the first command [s].
_SETTLING = 0.3
_COMMAND_AGE = 0.5  # s
_VOLTAGE_AGE = 5.0  # s
_MAX_VALUE = 1e3  # rad/s; larger rates and throttles are invalid
_MIN_DATA = 50
_BLOCK_DURATION = 5.0  # s, of the parts of a long flight
_PER_ODOMETRY = ("time", "p_WB", "v_WB_W", "R_WB", "w_WB_B", "voltage")
_PER_COMMAND = ("command_time", "throttle", "w_command")


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements:
    """n odometries and m commands, in order of time [s] since the first odometry.

    Shapes: ``p_WB``, ``v_WB_W``, ``w_WB_B`` (n, 3); ``R_WB`` (n, 3, 3); ``throttle`` (m,) in 0 to
    1; ``w_command`` (m, 3) [rad/s]. A command's time is the stamp of the odometry it answers.
    ``usable`` (n,) is true where the vehicle flies and executes commands. ``command_age`` is the
    median time from the stamp of the odometry to the command's publication [s], NaN if the clocks
    differ. The thrust is relative to the thrust of ``vehicle``.

    ``voltage`` (n,) [V] is smoothed as in a bridge, and NaN everywhere if a part of the flight has
    no voltage. The thrust scale of the fit holds at ``reference_voltage`` [V]. Commands were
    already compensated with the exponent ``compensated``.
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
    voltage: Array
    reference_voltage: float
    compensated: float

    @property
    def knows_voltage(self) -> bool:
        """Whether the voltage was recorded during the whole flight."""
        return not math.isnan(self.reference_voltage)

    @property
    def period(self) -> float:
        """Usual time between two odometries [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def flown(self) -> float:
        """Time in which the vehicle flies and executes commands [s]."""
        return float(np.count_nonzero(self.usable) * self.period)

    def thinned(self, most: int) -> Measurements:
        """Return about ``most`` odometries, in blocks spread evenly over the flight.

        Commands in the blocks and in the block before each are kept.
        """
        if len(self.time) <= most:
            return self
        block = np.floor(self.time / _BLOCK_DURATION)
        numbers = np.unique(block[self.usable])
        kept = numbers[:: -(-np.count_nonzero(self.usable) // most)]
        chosen = np.isin(block, kept)
        # No measurement spans a gap.
        usable = self.usable & np.append(chosen[1:], True)
        command_block = np.floor(self.command_time / _BLOCK_DURATION)
        commanded = np.isin(command_block, kept) | np.isin(command_block + 1, kept)
        return dataclasses.replace(
            self,
            usable=usable[chosen],
            **{name: getattr(self, name)[chosen] for name in _PER_ODOMETRY},
            **{name: getattr(self, name)[commanded] for name in _PER_COMMAND},
        )


def measurements_of(
    run: RecordedRun,
    *,
    vehicle: Vehicle,
    twist_frame: str,
    bridge: Mapping[str, Any] = MappingProxyType({}),
) -> Measurements:
    """Return the measurements of a recording with the twist in the ``child`` or ``world`` frame.

    ``bridge`` are the parameters of the bridge: it scaled the thrust by (voltage /
    ``thrust_map.battery_voltage`` [V]) to the power ``thrust_map.battery_exponent``. A voltage or
    an exponent of 0 disables this compensation. Raises :class:`BagError` without commands, or with
    too little flight under commands.
    """
    places = _usable_places(run.odometries)
    command_ns, throttle, w_command = _usable_commands(run.commands)
    if len(places) < _MIN_DATA:
        raise BagError(f"{run.bag}: {len(places)} usable odometries, expected {_MIN_DATA} or more")
    if len(command_ns) < 2:
        raise BagError(
            f"{run.bag}: {len(command_ns)} commands, expected the flight's commands, "
            "geometry_msgs/msg/TwistStamped with the throttle in linear.z, on a topic that ends "
            "in /command or on --command-topic"
        )
    stamp_ns = run.odometries.stamp_ns[places]
    time = (stamp_ns - stamp_ns[0]) * 1e-9
    p_WB, q_WB_xyzw, v, w = (
        run.odometries.column(name)[places] for name in ("p_WB", "q_WB_xyzw", "v_WB_B", "w_WB_B")
    )
    R_WB = so3.rotation_from_quaternion_xyzw(q_WB_xyzw)
    if twist_frame == "child":
        v = np.einsum("nij,nj->ni", R_WB, v)
    else:
        w = np.einsum("nji,nj->ni", R_WB, w)
    command_time = (command_ns - stamp_ns[0]) * 1e-9
    recorded_ns = run.odometries.log_time_ns[places]
    acting = _acting(run.engagements, recorded_ns)
    usable = _flying(p_WB, v) & _commanded(time, command_time) & acting
    if np.count_nonzero(usable) < _MIN_DATA:
        raise BagError(
            f"{run.bag}: {np.count_nonzero(usable)} odometries in flight under commands, "
            f"expected {_MIN_DATA} or more; the commands are stamped {command_time[0]:.3f} s to "
            f"{command_time[-1]:.3f} s after the first odometry, the odometries end at "
            f"{time[-1]:.3f} s, and commands were active for {np.mean(acting):.0%} of them"
        )
    voltage = _smoothed(run.voltages, recorded_ns, usable=usable)
    mean_voltage = float(np.mean(voltage[usable]))
    map_voltage = float(bridge.get("thrust_map.battery_voltage") or 0.0)
    exponent = float(bridge.get("thrust_map.battery_exponent", 0.0))
    age = float(np.median((run.commands.publish_time_ns - run.commands.stamp_ns) * 1e-9))
    return Measurements(
        time=time,
        p_WB=p_WB,
        v_WB_W=v,
        R_WB=R_WB,
        w_WB_B=w,
        command_time=command_time,
        throttle=np.clip(throttle, 0.0, 1.0),
        w_command=np.ascontiguousarray(w_command),
        usable=usable,
        command_age=age if 0.0 <= age < 1.0 else math.nan,
        vehicle=vehicle,
        voltage=voltage,
        reference_voltage=mean_voltage
        if math.isnan(mean_voltage)
        else map_voltage or mean_voltage,
        compensated=exponent if map_voltage > 0.0 else 0.0,
    )


def recorded_bridge(parameters: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the parameters of the bridge among recorded nodes; empty without a bridge."""
    for values in parameters.values():
        if any(name.startswith("thrust_map.") for name in values):
            return values
    return {}


def _usable_places(odometries: Log[OdometrySample]) -> NDArray[np.intp]:
    """Return the indices of valid odometries, in order of stamps, each stamp once."""
    fit = [odometry_fault(each.value, frame_id=each.value.frame_id) is None for each in odometries]
    places = np.flatnonzero(fit)
    _, first = first_by_stamp(odometries.stamp_ns[places])
    return places[first]


def _usable_commands(commands: Log[CommandSample]) -> tuple[Stamps, Array, Array]:
    """Return ascending stamps (m,), throttle (m,) and rates (m, 3) of valid commands."""
    throttle, rates = commands.column("throttle"), commands.column("w_WB_B")
    # Comparisons with NaN are false, so NaN is invalid.
    usable = (np.abs(throttle) <= _MAX_VALUE) & np.all(np.abs(rates) <= _MAX_VALUE, axis=1)
    places = np.flatnonzero(usable)
    stamp_ns, first = first_by_stamp(commands.stamp_ns[places])
    return stamp_ns, throttle[places[first]], rates[places[first]]


def _flying(p_WB: Array, v_WB_W: Array) -> NDArray[np.bool_]:
    """Return at which odometries (n,) the vehicle is certainly not on the ground.

    Near its first and last position the vehicle may be on the ground, where ground forces act. A
    vehicle that stays at its position counts as hovering.
    """
    flying = np.ones(len(p_WB), dtype=bool)
    for order in (slice(None), slice(None, None, -1)):
        distance = np.linalg.norm(p_WB[order] - p_WB[order][0], axis=1)
        left = int(np.argmax(distance > _LEFT_RADIUS))  # 0 when it never does
        if left and np.linalg.norm(v_WB_W[order][0]) < _REST_SPEED:
            stood = np.flatnonzero(distance[:left] <= _GROUND_RADIUS)[-1]
            flying[order][: stood + 1] = False
    return flying


def _commanded(time: Array, command_time: Array) -> NDArray[np.bool_]:
    """Return at which odometries (n,) commands are recent and the first command is long ago."""
    place = np.searchsorted(command_time, time, side="right") - 1
    age = time - command_time[np.maximum(place, 0)]
    return np.asarray((place >= 0) & (age < _COMMAND_AGE) & (time > command_time[0] + _SETTLING))


def _acting(
    engagements: Sequence[Received[bool]], recorded_ns: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return whether the vehicle executed commands at the log time of each odometry (n,) [ns].

    After each engagement, some time must pass. Initially, commands count as executed.
    """
    acting = np.ones(len(recorded_ns), dtype=bool)
    acts = True
    for change in engagements:
        if change.value is not acts:
            acts = change.value
            acting[recorded_ns >= change.log_time_ns] = acts
            if acts:
                settled_ns = change.log_time_ns + _SETTLING * 1e9
                acting[(recorded_ns >= change.log_time_ns) & (recorded_ns < settled_ns)] = False
    return acting


def _smoothed(
    voltages: Sequence[Received[float]],
    recorded_ns: NDArray[np.int64],
    *,
    usable: NDArray[np.bool_],
) -> Array:
    """Return the smoothed voltage at each odometry (n,) [V].

    NaN everywhere if a ``usable`` (n,) odometry is too far from the next measured voltage.
    """
    smoothed = SmoothedVoltage()
    times_ns, values = [], []
    for each in voltages:
        if smoothed.receive(each.value, now_ns=each.log_time_ns) and smoothed.value is not None:
            times_ns.append(each.log_time_ns)
            values.append(smoothed.value)
    if not values:
        return np.full(len(recorded_ns), np.nan)
    place = np.maximum(np.searchsorted(times_ns, recorded_ns, side="right") - 1, 0)
    away = np.abs(recorded_ns - np.array(times_ns)[place])
    if np.any(away[usable] > _VOLTAGE_AGE * 1e9):
        return np.full(len(recorded_ns), np.nan)
    return np.array(values)[place]
