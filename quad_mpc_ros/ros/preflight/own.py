# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of a node's own parameters, for valid values that are probably not intended.

Invalid values are rejected by ``Configuration.check``.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from pathlib import Path

from quad_mpc_ros.configuration import Configuration, per_axis
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.ocp.margins import stability_margins
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.ros.preflight.finding import Finding, warning
from quad_mpc_ros.ros.rate_loop_monitor import rate_loop_finding

STACK_FAULT_KEY, LANDED_KEY = "stack_fault", "landed"
"""Keys in a bridge's diagnostics: error of the stack, and whether the vehicle has landed."""

# Thrust over weight: with less at full throttle, wind and climbs saturate the thrust; with more at
# minimum throttle, the vehicle hardly descends.
_MIN_LIFT, _MAX_IDLE = 1.4, 0.7
_MIN_DELAY_MARGIN = 0.02  # s: a control period of the default
# bytes: ten minutes at 50 Hz take about 30 MB.
_MIN_FREE_BYTES = 1_000_000_000


def own_findings(config: Configuration) -> list[Finding]:
    """Return the findings in a node's own parameters."""
    if isinstance(config, MpcConfig):
        lags = () if config.lockstep else lag_findings(config)
        found = [*lags, *throttle_findings(config), *limit_findings(config)]
        return [*found, *margin_findings(config)]
    if isinstance(config, RecorderConfig):
        return list(_disk_findings(bag_place(config)))
    return []


def lag_findings(mpc: MpcConfig) -> Iterator[Finding]:
    """Yield a warning for lags that are not modelled, and for rate loops that ring or are slow."""
    if mpc.unmodelled_lags:
        yield warning(
            f"{', '.join(mpc.unmodelled_lags)} = 0: every real vehicle lags, and a vehicle that "
            "lags more than modelled oscillates",
            "set an estimate, and after a first flight the result of quad_mpc identify",
        )
    loops = (per_axis(mpc.rate_time_constant), per_axis(mpc.torque_time_constant))
    axes: dict[tuple[float, float], list[str]] = {}
    for name, loop in zip(("roll", "pitch", "yaw"), zip(*loops, strict=True), strict=True):
        axes.setdefault(loop, []).append(name)
    for (tau, torque), names in axes.items():
        if found := rate_loop_finding(", ".join(names), tau=tau, torque=torque):
            yield found


def margin_findings(mpc: MpcConfig) -> Iterator[Finding]:
    """Yield a warning if little unmodelled delay makes the hover oscillate."""
    delay = stability_margins(mpc).delay
    if mpc.controller == MPC and delay < _MIN_DELAY_MARGIN:
        yield warning(
            f"the hover oscillates with {1e3 * delay:.0f} ms more delay than input_delay, "
            f"expected {1e3 * _MIN_DELAY_MARGIN:.0f} ms or more",
            "raise R, or lower Q",
        )


def throttle_findings(mpc: MpcConfig) -> Iterator[Finding]:
    """Yield warnings for throttle bounds with little margin around hover."""
    weight = mpc.mass * mpc.gravity
    lift, idle = mpc.thrust(mpc.throttle_max) / weight, mpc.thrust(mpc.throttle_min) / weight
    tilt = mpc.limits.tilt_max
    if lift < _MIN_LIFT:
        yield warning(
            f"at throttle_max {mpc.throttle_max:g} the motors lift {lift:.2f} times the "
            f"weight, expected {_MIN_LIFT:g} or more",
            "check mass, motor_count and thrust_curve, or raise throttle_max",
        )
    elif mpc.on_manifold and 0.0 < tilt < math.pi and lift * math.cos(tilt) < 1.0:
        yield warning(
            f"at limits.tilt_max {tilt:g} rad and throttle_max {mpc.throttle_max:g} the "
            f"motors lift {max(lift * math.cos(tilt), 0.0):.2f} times the weight: the vehicle "
            "would sink",
            f"set limits.tilt_max below {math.acos(1.0 / lift):.2f}",
        )
    if idle > _MAX_IDLE:
        yield warning(
            f"at throttle_min {mpc.throttle_min:g} the motors still lift {idle:.2f} times the "
            f"weight, expected {_MAX_IDLE:g} or less: the vehicle hardly descends",
            "reduce throttle_min",
        )


def limit_findings(mpc: MpcConfig) -> Iterator[Finding]:
    """Yield warnings for limits of the plan beyond the envelope."""
    envelope, limits = mpc.envelope, mpc.limits
    planned = [("omega_max", max(mpc.omega_max), "envelope.rate_max", envelope.rate_max, "rad/s")]
    if mpc.on_manifold:
        # A plan without limit is unlimited; so is a tilt of pi.
        tilt = limits.tilt_max or math.pi
        planned.append(("limits.tilt_max", tilt, "envelope.tilt_max", envelope.tilt_max, "rad"))
        speed = envelope.speed_max
        planned.append(("limits.speed_max", limits.speed_max, "envelope.speed_max", speed, "m/s"))
    for name, value, bound, most, unit in planned:
        if value > most:
            yield warning(
                f"{name} allows {value:.3g} {unit} in the plan, {bound} is {most:.3g} with action "
                f"{envelope.action}",
                f"set {name} below {bound}",
            )


def bag_place(recorder: RecorderConfig) -> Path:
    """Return the existing folder below which the recorder writes its bag."""
    wanted = Path(recorder.directory).resolve().parent if recorder.directory else Path.cwd()
    return next(folder for folder in (wanted, *wanted.parents) if folder.exists())


def free_bytes(place: Path) -> int:
    """Return the free space on the disk of a folder [bytes]; 0 if unknown."""
    try:
        return shutil.disk_usage(place).free
    except OSError:
        return 0


def _disk_findings(place: Path) -> Iterator[Finding]:
    """Yield a warning if the free space is low."""
    free = free_bytes(place)
    if free < _MIN_FREE_BYTES:
        yield warning(
            f"{free / 1e6:.0f} MB free for the bag in {place}, expected "
            f"{_MIN_FREE_BYTES / 1e6:.0f} MB",
            "delete old bags, or set recorder.directory to another disk",
        )
