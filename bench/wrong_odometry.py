# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly with odometry in wrong conventions, and with vehicles that do not follow commands.

python -P bench/wrong_odometry.py                          # all, in the air and from the ground
python -P bench/wrong_odometry.py --only heading --plant internal

Each case flies a hover at 2 m with noise and gusts: engaged in the air 0.1 m away from it, or
from the ground by a take-off on request. For each a line: when the contradiction was found [s]
after the engagement or the request, how far the vehicle was from its start then and how far it
came at most, horizontally and upwards [m], and what the log says. A flight ends on the ground,
30 m away, or after its time. docs/measurements/failures.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant
from quad_mpc_ros.simulation.sensors import OdometryStream

HEIGHT, OFFSET = 2.0, 0.1  # m
TAKE_OFF_AT = 1.0  # s
FARTHEST = 30.0  # m
STARTS = ("air", "ground")
NOISE = {
    "position_noise": 0.003,
    "attitude_noise": 0.003,
    "velocity_noise": 0.02,
    "rate_noise": 0.02,
    "gust_intensity": 0.3,
}
FLU_FRD = np.diag([1.0, -1.0, -1.0])
ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

Distortion = Callable[[OdometrySample], OdometrySample]
Actuation = Callable[[float, Array], tuple[float, Array]]


def changed(
    odometry: OdometrySample,
    *,
    p_WB: Array | None = None,
    R_WB: Array | None = None,
    v_WB_B: Array | None = None,
    w_WB_B: Array | None = None,
) -> OdometrySample:
    """Return an odometry with some of its values replaced."""
    given = {"p_WB": p_WB, "v_WB_B": v_WB_B, "w_WB_B": w_WB_B}
    if R_WB is not None:
        given["q_WB_xyzw"] = so3.quaternion_xyzw_from_rotation(R_WB)
    return dataclasses.replace(odometry, **{k: v for k, v in given.items() if v is not None})


def rotation(odometry: OdometrySample) -> Array:
    """Return R_WB (3, 3)."""
    return so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)


def scaled(quantity: str, factor: float | Array) -> Distortion:
    """Return the distortion that multiplies p_WB, v_WB_B or w_WB_B."""
    return lambda o: dataclasses.replace(o, **{quantity: factor * getattr(o, quantity)})


def mapped(axes: Array, *, velocity: bool = True) -> Distortion:
    """Return the distortion that maps the world's axes of position and velocity."""

    def distort(odometry: OdometrySample) -> OdometrySample:
        R_WB = rotation(odometry)
        v_WB_B = R_WB.T @ axes @ R_WB @ odometry.v_WB_B if velocity else None
        return changed(odometry, p_WB=axes @ odometry.p_WB, v_WB_B=v_WB_B)

    return distort


def turned(degrees: float, *, velocity: bool) -> Distortion:
    """Return the distortion that turns the heading, and the velocity in the world with it or not.

    Odometry has its velocity in the body frame: one that is right there turns with the heading.
    """
    turn = so3.exp(np.array([0.0, 0.0, math.radians(degrees)]))

    def distort(odometry: OdometrySample) -> OdometrySample:
        R_WB = rotation(odometry)
        v_WB_B = None if velocity else (turn @ R_WB).T @ R_WB @ odometry.v_WB_B
        return changed(odometry, R_WB=turn @ R_WB, v_WB_B=v_WB_B)

    return distort


def ned_and_frd(odometry: OdometrySample) -> OdometrySample:
    """Return an odometry as PX4 has it."""
    return changed(
        odometry,
        p_WB=ENU_NED @ odometry.p_WB,
        R_WB=ENU_NED @ rotation(odometry) @ FLU_FRD,
        v_WB_B=FLU_FRD @ odometry.v_WB_B,
        w_WB_B=FLU_FRD @ odometry.w_WB_B,
    )


def frd_twist(odometry: OdometrySample) -> OdometrySample:
    """Return an odometry whose twist alone is in FRD."""
    v_WB_B, w_WB_B = FLU_FRD @ odometry.v_WB_B, FLU_FRD @ odometry.w_WB_B
    return changed(odometry, v_WB_B=v_WB_B, w_WB_B=w_WB_B)


def frd_body(odometry: OdometrySample) -> OdometrySample:
    """Return an odometry whose body frame is FRD."""
    return changed(frd_twist(odometry), R_WB=rotation(odometry) @ FLU_FRD)


CONVENTIONS: dict[str, Distortion] = {
    "NED and FRD": ned_and_frd,
    "position in NED": lambda o: changed(o, p_WB=ENU_NED @ o.p_WB),
    "twist in FRD": frd_twist,
    "body frame FRD": frd_body,
    "world NED, body FLU": lambda o: changed(o, p_WB=ENU_NED @ o.p_WB, R_WB=ENU_NED @ rotation(o)),
    "z down": mapped(np.diag([1.0, 1.0, -1.0])),
    "x reversed": mapped(np.diag([-1.0, 1.0, 1.0])),
    "y reversed": mapped(np.diag([1.0, -1.0, 1.0])),
    "x and y swapped": mapped(SWAPPED),
    "x of the position reversed": mapped(np.diag([-1.0, 1.0, 1.0]), velocity=False),
    "x and y of the position swapped": mapped(SWAPPED, velocity=False),
    "heading off by 90 degrees": turned(90.0, velocity=True),
    "heading off by -90 degrees": turned(-90.0, velocity=True),
    "heading off by 180 degrees": turned(180.0, velocity=True),
    "heading off by 90 degrees, velocity right": turned(90.0, velocity=False),
    "attitude conjugated": lambda o: changed(o, R_WB=rotation(o).T),
    "quaternion w, x, y, z": lambda o: dataclasses.replace(o, q_WB_xyzw=np.roll(o.q_WB_xyzw, 1)),
    "rates in deg/s": scaled("w_WB_B", math.degrees(1.0)),
    "rates reversed": scaled("w_WB_B", -1.0),
    "roll rate reversed": scaled("w_WB_B", np.array([-1.0, 1.0, 1.0])),
    "velocity reversed": scaled("v_WB_B", -1.0),
    "velocity in cm/s": scaled("v_WB_B", 100.0),
    "position in cm": scaled("p_WB", 100.0),
}
"""What is reported instead of the odometry."""

FAULTS: dict[str, Actuation] = {
    "roll command reversed": lambda s, w: (s, np.array([-1.0, 1.0, 1.0]) * w),
    "pitch command reversed": lambda s, w: (s, np.array([1.0, -1.0, 1.0]) * w),
    "yaw command reversed": lambda s, w: (s, np.array([1.0, 1.0, -1.0]) * w),
    "roll and pitch swapped": lambda s, w: (s, w[[1, 0, 2]]),
    "rates ignored": lambda s, w: (s, 0.0 * w),
    "no thrust": lambda s, w: (0.0, w),
    "throttle reversed": lambda s, w: (1.0 - s, w),
    "a quarter of the throttle": lambda s, w: (0.25 * s, w),
}
"""What reaches the actuators of a command."""


class BlockedRotor(RotorsPlant):
    """The plant ``rotors``, of which one rotor does not turn."""

    def _move(self, *, duration_ns: int) -> None:
        while duration_ns > 0:
            self._speeds[0] = 0.0
            part_ns = min(duration_ns, 1_000_000)
            super()._move(duration_ns=part_ns)
            duration_ns -= part_ns


class HeldVehicle(RotorsPlant):
    """The plant ``rotors``, held by hand where it starts."""

    def _move(self, *, duration_ns: int) -> None:
        """Stay."""


VEHICLES: dict[str, type[RotorsPlant]] = {
    "a rotor blocked": BlockedRotor,
    "held by hand": HeldVehicle,
}
"""What is flown instead of the vehicle."""


class Moment(NamedTuple):
    """One odometry of a flight: time [s], true position, active source and reason."""

    seconds: float
    p_WB: Array
    source: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Results of a flight; distances [m] from the start, horizontally and upwards."""

    found_after: float | None
    found_at: tuple[float, float] | None
    farthest: tuple[float, float]
    reason: str


def flight(
    case: str,
    *,
    start: str = "air",
    plant: str = "rotors",
    duration: float = 9.0,
    mpc: MpcConfig | None = None,
    **simulator: object,
) -> Iterator[Moment]:
    """Fly a case, or with none of the names a vehicle and an odometry that are right."""
    distort = CONVENTIONS.get(case, lambda odometry: odometry)
    actuate = FAULTS.get(case, lambda throttle, rates: (throttle, rates))
    given = {**NOISE, "plant": plant, "duration": duration, **simulator}
    if start == "air":
        hover = SimulatorConfig().vehicle().hover_throttle
        given |= {"initial_position": (OFFSET, -OFFSET, HEIGHT), "initial_throttle": hover}
    config = SimulatorConfig().updated(given)
    body, controller = VEHICLES.get(case, make_plant)(config), warmed_up(mpc or MpcConfig())
    stream = OdometryStream(body, config, start_stamp_ns=SIMULATION_START_NS)
    windows = _requested() if start == "ground" else _held()
    while (sent := stream.step()) is not None:
        odometry = distort(sent.odometry)
        seconds = 1e-9 * (odometry.stamp_ns - SIMULATION_START_NS)
        tick = controller.step(odometry, windows(odometry, controller.ground_state))
        if tick is None:
            continue
        if tick.command is not None:
            throttle, rates = actuate(tick.command.throttle, tick.command.w_WB_B)
            body.apply(
                CommandSample(stamp_ns=tick.command.stamp_ns, throttle=throttle, w_WB_B=rates)
            )
        decision, p_WB = tick.decision, sent.truth.p_WB.copy()
        yield Moment(seconds, p_WB, decision.source.name.lower(), decision.reason)
        fallen = start == "air" and p_WB[2] < 0.02
        if fallen or math.hypot(*p_WB) > FARTHEST:
            return


def _held() -> Callable[..., ReferenceWindow]:
    """Return the windows of a hover."""
    window = ReferenceWindow.hover([0.0, 0.0, HEIGHT])
    return lambda odometry, _: dataclasses.replace(window, stamp_ns=odometry.stamp_ns)


def _requested() -> Callable[..., ReferenceWindow]:
    """Return the windows of a take-off on request."""
    config = ReferenceConfig(trajectory="hover", mode="on_request", takeoff_height=HEIGHT)
    trajectory = configured_trajectory(config)
    live = LiveReference(config, trajectory, joined=lambda: trajectory)
    requested = False

    def window(odometry: OdometrySample, ground: object) -> ReferenceWindow:
        nonlocal requested
        now_ns = odometry.stamp_ns
        live.observe(odometry)
        live.set_ground_state(ground)
        if not requested and now_ns - SIMULATION_START_NS >= 1e9 * TAKE_OFF_AT:
            requested = True
            live.take_off(now_ns)
        found = live.window(now_ns)
        assert found is not None
        return found

    return window


def outcome(moments: Sequence[Moment]) -> Outcome:
    """Return the result of a flight."""
    away = np.array([moment.p_WB for moment in moments]) - moments[0].p_WB
    horizontal, up = np.hypot(away[:, 0], away[:, 1]), away[:, 2]
    found = next((k for k, each in enumerate(moments) if is_found(each.reason)), None)
    return Outcome(
        found_after=None if found is None else moments[found].seconds,
        found_at=None if found is None else (float(horizontal[found]), float(up[found])),
        farthest=(float(horizontal.max()), float(max(up.max(), 0.0))),
        reason="" if found is None else moments[found].reason,
    )


def is_found(reason: str) -> bool:
    """Whether a reason is a contradiction."""
    return "disagree" in reason or "do not lift" in reason


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="cases whose name has it")
    parser.add_argument("--plant", default="rotors", help="plant of the simulator")
    parser.add_argument("--wind", type=float, default=0.0, help="towards east [m/s]")
    options = parser.parse_args(arguments)
    print(f"{'case':42} start   found  horiz.    up | farthest    up | log")
    cases = [each for each in ("right", *CONVENTIONS, *FAULTS, *VEHICLES) if options.only in each]
    for start in STARTS:
        for case in cases:
            wind = (options.wind, 0.0, 0.0)
            found = outcome(list(flight(case, start=start, plant=options.plant, wind=wind)))
            begun = TAKE_OFF_AT if start == "ground" else 0.0
            at = "      -       -     -"
            if found.found_after is not None and found.found_at is not None:
                horizontal, up = found.found_at
                at = f"{found.found_after - begun:7.2f} {horizontal:7.2f} {up:5.2f}"
            farthest, top = found.farthest
            print(f"{case:42} {start:6}{at} | {farthest:8.2f} {top:5.2f} | {found.reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
