# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The interface of controllers that fly in place of the MPC."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow


@runtime_checkable
class ControlLaw(Protocol):
    """A controller: odometry and reference in, command out.

    A class of this protocol is created with the :class:`.MpcConfig` of the flight, whose
    ``vehicle()`` has mass and thrust curve. The parameter ``mpc.controller`` selects the class by
    name or as ``module:Class``. Input checks, command limits and failsafe of the MPC apply.
    A class with the attribute ``commands_rotors = True`` returns a :class:`.RotorCommand`.
    """

    def reset(self) -> None:
        """Discard the state: before the first step, after engagement and odometry jumps."""

    def step(self, odometry: OdometrySample, reference: ReferenceWindow) -> CommandSample:
        """Return the command for an odometry.

        Args:
            odometry: Newest odometry: pose in ENU, twist in body axes (FLU).
            reference: Reference window; the first sample is at the odometry's stamp.
        """
