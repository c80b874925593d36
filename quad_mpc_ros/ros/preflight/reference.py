# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the reference against the limits of MPC, envelope and fence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quad_mpc_ros.control.config import EnvelopeParameters, MpcConfig
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.flight_limits import FlightLimits
from quad_mpc_ros.control.safety.ladder import Action
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import judged_trajectory
from quad_mpc_ros.ros.preflight.facts import Facts, ReferenceSamples
from quad_mpc_ros.ros.preflight.finding import Finding, error, ok, unknown, warning
from quad_mpc_ros.ros.preflight.own import limit_findings

_MAX_SAMPLES = 500
_UNKNOWN = unknown("the parameters of mpc or reference are unknown")


def sample_reference(config: ReferenceConfig) -> ReferenceSamples:
    """Return samples along a configured reference, as odometry.

    Raises :class:`UserError` if this is impossible, as for a file on another computer.
    """
    _, verdict = judged_trajectory(config)
    samples = verdict.samples
    R_WB = so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)
    v_WB_B = np.einsum("nji,nj->ni", R_WB, samples.v_WB_W)
    w_WB_B = verdict.over_time.w_WB_B
    return tuple(
        OdometrySample(
            stamp_ns=0,
            frame_id=config.frame_id,
            p_WB=samples.p_WB[i],
            q_WB_xyzw=samples.q_WB_xyzw[i],
            v_WB_B=v_WB_B[i],
            w_WB_B=w_WB_B[i],
        )
        for i in range(0, len(samples.p_WB), max(len(samples.p_WB) // _MAX_SAMPLES, 1))
    )


def limits_findings(facts: Facts) -> list[Finding]:
    """Check that the reference's limits are inside the plan's and the envelope's."""
    if facts.mpc is None:
        return [_UNKNOWN]
    found = [*limit_findings(facts.mpc), *_speed_findings(facts.mpc, facts.reference)]
    return found or [ok("of reference, plan and envelope are consistent")]


def _speed_findings(mpc: MpcConfig, reference: ReferenceConfig | None) -> Iterator[Finding]:
    """Yield an error or a warning if the reference is faster than envelope or plan."""
    if reference is None:
        return
    speed, envelope = reference.max_speed, mpc.envelope
    if speed > envelope.speed_max:
        judged = warning if envelope.action == "warn" else error
        yield judged(
            f"reference.max_speed is {speed:g} m/s, mpc.envelope.speed_max "
            f"{envelope.speed_max:g} with action {envelope.action}",
            "reduce max_speed, or increase envelope.speed_max",
        )
    elif 0.0 < mpc.limits.speed_max < speed:
        yield warning(
            f"reference.max_speed is {speed:g} m/s, mpc.limits.speed_max "
            f"{mpc.limits.speed_max:g}: the MPC falls behind",
            "reduce max_speed, or increase limits.speed_max",
        )


def fence_findings(facts: Facts) -> list[Finding]:
    """Check that the vehicle, its take-off and the reference are within fence and envelope."""
    mpc = facts.mpc
    if mpc is None:
        return [_UNKNOWN]
    if not mpc.fence.has_walls and mpc.envelope == EnvelopeParameters():
        if facts.bridges:
            return [warning("no fence is set", "set fence.minimum and fence.maximum of mpc")]
        return [ok("none is set")]
    found = []
    limits = FlightLimits(mpc)
    for name, samples, remedy in _checked_samples(facts):
        breaches = [each for sample in samples if (each := limits.breach_at(sample)) is not None]
        if breaches:
            breach = max(breaches, key=lambda each: each.action)
            judged = warning if breach.action is Action.WARN else error
            found.append(judged(f"{name} would break a limit: {breach.reason}", remedy))
    if facts.reference_samples_error:
        found.append(unknown(f"path of the reference: {facts.reference_samples_error}"))
    return found or [ok("vehicle, take-off and reference are inside")]


def _checked_samples(facts: Facts) -> Iterator[tuple[str, Sequence[OdometrySample], str]]:
    """Yield the samples that must be inside, each with name and remedy."""
    here: Array = np.zeros(3)
    if facts.arrivals:
        here = facts.arrivals[-1].odometry.p_WB
        remedy = "move the vehicle inside, or change the fence"
        yield "the vehicle", [OdometrySample.at_rest(here)], remedy
    if facts.reference is not None:
        height = facts.reference.takeoff_height
        above = OdometrySample.at_rest(here + np.array([0.0, 0.0, height]))
        remedy = "lower reference.takeoff_height, or raise fence.maximum"
        yield f"a take-off to {height:g} m", [above], remedy
    if facts.reference_samples is not None:
        remedy = "change the path, or widen fence.* or envelope.*"
        yield "the reference", facts.reference_samples, remedy
