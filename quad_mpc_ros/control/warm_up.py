"""Letting everything compile before the first tick, which in the air has no time for it."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.mpc_config import MpcConfig

# No further apart than odometries that something is learned between, and longer than any delay
# of the input: learning compiles as well.
_TICKS_NS = (1_000_000_000, 1_300_000_000, 1_600_000_000, 1_620_000_000)
# Longer after the last of them than any timeout below.
_BLIND_NS = 5_000_000_000
_HOVERING_NS = (5_100_000_000, 6_000_000_000)

_SHIPPED = MpcConfig()
_WEIGHTS = ("Q", "R", "terminal_weight")


def warmed_up(config: MpcConfig, *, deadline: float = math.inf) -> Controller:
    """Return a new controller, none of whose code is left to compile."""
    _compile(
        dataclasses.replace(
            config,
            # Whatever they are, the code is the same; campaigns have many.
            **{name: getattr(_SHIPPED, name) for name in _WEIGHTS},
            horizon_steps=2,
            lockstep=False,
            odom_timeout=2.0,
            reference_timeout=2.0,
            plan_hold_time=0.2,
            blind_time=10.0,
        )
    )
    return Controller(config, deadline=deadline)


@functools.cache
def _compile(config: MpcConfig) -> None:
    """Run a few ticks of a controller that nobody listens to."""
    controller, frame_id = Controller(config), config.odometry.frame_id
    for stamp_ns in _TICKS_NS:
        held = ReferenceWindow.hover(np.zeros(3), stamp_ns=stamp_ns, frame_id=frame_id)
        controller.receive_reference(held, now_ns=stamp_ns)
        controller.receive_odometry(_moving_at(stamp_ns, config), now_ns=stamp_ns)
        controller.take_warnings()
    # Then without odometry, and last without reference: who flies then must not compile either.
    controller.watch(now_ns=_BLIND_NS)
    for stamp_ns in _HOVERING_NS:
        controller.receive_odometry(_moving_at(stamp_ns, config), now_ns=stamp_ns)
        controller.take_warnings()


def _moving_at(stamp_ns: int, config: MpcConfig) -> OdometrySample:
    """Return an odometry in flight, slow enough for a throttle within its bounds: one learns."""
    resting = OdometrySample.at_rest(
        [0.3e-9 * stamp_ns, 0.0, 0.0], stamp_ns=stamp_ns, frame_id=config.odometry.frame_id
    )
    return dataclasses.replace(resting, v_WB_B=np.array([0.3, 0.0, 0.0]))
