# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the odometry: rate, clock, and values at rest."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.state import with_body_twist
from quad_mpc_ros.control.safety.consistency import motion_contradiction
from quad_mpc_ros.control.safety.odometry_gate import NOT_ADVANCING, OdometryGate
from quad_mpc_ros.ros.preflight.facts import SIMULATOR_NODE, Arrival, Facts
from quad_mpc_ros.ros.preflight.finding import Finding, error, ok, unknown, warning
from quad_mpc_ros.simulation.config import SimulatorConfig

_MIN_ODOMETRIES, _MIN_DURATION = 10, 1.0  # required odometries, or seconds
_MIN_RATE_RATIO = 0.95  # of the control rate
_MAX_JITTER_RATIO = 0.3  # of a period
_MAX_CLOCK_OFFSET = 0.1  # s: bridges reject older commands
# At rest: positions within [m]; then speed [m/s], body rate [rad/s] and tilt [rad] at most.
_REST_RADIUS, _REST_SPEED, _REST_RATE, _REST_TILT = 0.05, 0.3, 0.2, 0.35
_NO_ODOMETRY = unknown("no odometry received")


def rate_findings(facts: Facts) -> list[Finding]:
    """Check rate and regularity of the odometry."""
    mpc, arrivals = facts.mpc, facts.arrivals
    if len(arrivals) < 2:
        return [
            error(
                "no odometry received" if not arrivals else "only one odometry received",
                "start its source; the checks nodes and topics show what is missing",
            )
        ]
    steps = [1e-9 * (b.odometry.stamp_ns - a.odometry.stamp_ns) for a, b in pairwise(arrivals)]
    duration = sum(steps)
    if duration <= 0.0:
        return [error(NOT_ADVANCING, "set header.stamp to the time of each measurement")]
    if mpc is None or (len(arrivals) < _MIN_ODOMETRIES and duration < _MIN_DURATION):
        return [unknown(f"{len(arrivals)} odometries received, too few to measure the rate")]
    rate = len(steps) / duration
    latencies = [1e-9 * (each.at_ns - each.odometry.stamp_ns) for each in arrivals]
    jitter = max(statistics.pstdev(steps), statistics.pstdev(latencies))
    found = list(_irregularities(mpc, rate, gap=max(steps), jitter=jitter))
    return found or [ok(f"{rate:.1f} Hz, jitter {1e3 * jitter:.1f} ms")]


def _irregularities(
    mpc: MpcConfig, rate: float, *, gap: float, jitter: float
) -> Iterator[Finding]:
    """Yield warnings for a low rate [Hz], a long gap [s] and jitter [s]."""
    if rate < _MIN_RATE_RATIO * mpc.control_rate:
        yield warning(
            f"odometry arrives at {rate:.1f} Hz, mpc.control_rate is {mpc.control_rate:g} "
            "Hz: commands are sent at the lower rate",
            "increase the rate of the source, or reduce control_rate",
        )
    if gap > mpc.odom_timeout:
        yield warning(
            f"gap of {gap:.2f} s between two odometries, mpc.odom_timeout is "
            f"{mpc.odom_timeout:g} s",
            "check the source for delays and the link for lost messages",
        )
    if jitter > _MAX_JITTER_RATIO / rate:
        yield warning(
            f"odometry arrives at {rate:.1f} Hz with a jitter of {1e3 * jitter:.0f} ms",
            "check the load of the computer and the link",
        )


def clock_findings(facts: Facts) -> list[Finding]:
    """Check that all nodes use one clock, and that the odometry is stamped with it."""
    found = _simulated_time(facts)
    if not facts.arrivals:
        return found or [_NO_ODOMETRY]
    ages = [1e-9 * (each.at_ns - each.odometry.stamp_ns) for each in facts.arrivals]
    least = min(ages, key=abs)
    if abs(least) > _MAX_CLOCK_OFFSET:
        side = "behind" if least > 0.0 else "ahead of"
        judged = error if facts.bridges else warning
        found.append(
            judged(
                f"the odometry's stamps are {abs(least):.2f} s {side} the clock of this computer",
                "synchronise the clocks (chrony), or set use_sim_time on all nodes: a bridge "
                "rejects commands with stamps off by more than 0.1 s",
            )
        )
    return found or [ok(f"odometry is {1e3 * statistics.median(ages):.0f} ms old on arrival")]


def _simulated_time(facts: Facts) -> list[Finding]:
    on: list[str] = []
    off: list[str] = []
    for name, node in facts.nodes.items():
        makes_time = isinstance(node.config, SimulatorConfig) and node.config.lockstep
        if not (name == SIMULATOR_NODE and makes_time):
            (on if node.use_sim_time else off).append(name)
    if on and off:
        return [
            error(
                f"use_sim_time is on for {', '.join(on)}, off for {', '.join(off)}",
                "set the same value on all nodes",
            )
        ]
    if on and not facts.has_clock:
        return [error("use_sim_time is on, but no node publishes /clock", "disable it")]
    return []


def motion_findings(facts: Facts) -> list[Finding]:
    """Check that the MPC accepts the odometry, and that its values are consistent."""
    mpc, arrivals = facts.mpc, facts.arrivals
    if mpc is None or len(arrivals) < _MIN_ODOMETRIES:
        return [unknown("too few odometries received")]
    found = _refused(mpc, arrivals)
    if found:
        return found
    p_WB = np.array([each.odometry.p_WB for each in arrivals])
    if float(np.abs(p_WB - p_WB.mean(axis=0)).max()) < _REST_RADIUS:
        return list(_at_rest(mpc, arrivals)) or [ok("at rest and level; twist agrees")]
    samples = [each.odometry for each in arrivals]
    turned = mpc.odometry.twist_frame == "world"
    samples = [with_body_twist(each) if turned else each for each in samples]
    contradiction = motion_contradiction(samples, mpc)
    if contradiction is not None:
        return [error(contradiction, "correct the source of the odometry")]
    return [ok("the vehicle moves; position, velocity, attitude and body rates agree")]


def _refused(mpc: MpcConfig, arrivals: Sequence[Arrival]) -> list[Finding]:
    """Return the odometries that the MPC would reject."""
    gate = OdometryGate(mpc)
    reasons = Counter(
        reason for each in arrivals if (reason := gate.refusal(each.odometry, now_ns=each.at_ns))
    )
    if not reasons:
        return []
    judged = error if 2 * reasons.total() > len(arrivals) else warning
    ((reason, _),) = reasons.most_common(1)
    return [
        judged(
            f"the MPC would reject {reasons.total()} of {len(arrivals)} odometries: {reason}",
            "fix the source of the odometry",
        )
    ]


def _at_rest(mpc: MpcConfig, arrivals: Sequence[Arrival]) -> Iterator[Finding]:
    """Yield contradictions in the odometry of a vehicle at rest."""
    samples = [each.odometry for each in arrivals]
    v = np.array([each.v_WB_B for each in samples])
    if mpc.odometry.twist_frame == "child":
        q = np.array([each.q_WB_xyzw for each in samples])
        v = np.einsum("nij,nj->ni", so3.rotation_from_quaternion_xyzw(q), v)
    speed = float(np.linalg.norm(v.mean(axis=0)))
    turn = float(np.linalg.norm(np.mean([each.w_WB_B for each in samples], axis=0)))
    tilt = math.acos(min(max(statistics.fmean(each.up for each in samples), -1.0), 1.0))
    if speed > _REST_SPEED:
        yield error(
            f"the position does not change, but the twist reports {speed:.2f} m/s",
            "fix the twist",
        )
    if turn > _REST_RATE:
        yield error(
            f"the attitude does not change, but the twist reports {turn:.2f} rad/s",
            "calibrate the gyroscope, or fix the twist",
        )
    if tilt > _REST_TILT:
        yield warning(
            f"the vehicle rests with a tilt of {tilt:.2f} rad, expected <= {_REST_TILT:g}",
            "place the vehicle level; if it is level, the frames are not ENU and FLU",
        )
