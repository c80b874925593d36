# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The inputs and outputs of a controller in a recorded flight, message by message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
from quad_mpc_ros.control.tick import TickStats
from quad_mpc_ros.recordings.logs import Log, Received


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """The messages of one vehicle, each kind in the order in which it was recorded.

    ``odometries`` (one or more) include those that a controller rejects. ``commands`` are the
    flown commands, ``stats`` the figures of the ticks, ``parameters`` are by node.
    ``engagements``: whether the vehicle executes commands from then on; initially true.
    ``landings``: whether the vehicle is on the ground from then on. ``resets``: odometry jumps.
    ``changes``: parameters of the controller set in flight. ``voltages`` of the battery [V].
    ``imu``: accelerometer samples.
    """

    bag: Path
    parameters: Mapping[str, Mapping[str, Any]]
    odometries: Log[OdometrySample] = field(default_factory=lambda: Log(OdometrySample))
    windows: list[Received[ReferenceWindow]] = field(default_factory=list)
    commands: Log[CommandSample] = field(default_factory=lambda: Log(CommandSample))
    stats: Log[TickStats] = field(default_factory=lambda: Log(TickStats))
    engagements: list[Received[bool]] = field(default_factory=list)
    landings: list[Received[bool]] = field(default_factory=list)
    resets: list[Received[EstimateReset]] = field(default_factory=list)
    changes: list[Received[Mapping[str, Any]]] = field(default_factory=list)
    voltages: list[Received[float]] = field(default_factory=list)
    imu: Log[ImuSample] = field(default_factory=lambda: Log(ImuSample))
