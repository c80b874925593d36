# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``mujoco``."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.extras.plants.mujoco.drive import Drive, drive
from quad_mpc_ros.extras.plants.mujoco.model import up_of
from quad_mpc_ros.extras.plants.mujoco.scene import MujocoScene
from quad_mpc_ros.simulation.optional_plants import MujocoParameters
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

_MAX_STEP_NS = 1_000_000  # half of the minimum time constant of a contact
_LANDED_THRUST_RATIO = 0.5  # of the weight


class MujocoPlant(RotorsPlant):
    """The plant ``rotors`` with ground, deck, landing gear and load, simulated by MuJoCo.

    Rotors, air and rate loop are as in the plant ``rotors``; only contacts hold the vehicle level
    or stop its motion. With ``initial_position`` at height 0 and no initial motion the vehicle
    starts on its feet, tilted like the ground.
    """

    def __init__(self, config: MujocoParameters) -> None:
        """Build the scene; raises :class:`UserError` if MuJoCo is not installed."""
        self._surroundings = config
        self._drive = Drive.zeros()
        self._moved_ns = 0
        super().__init__(config)

    def _start(self) -> None:
        """Set the configured initial state; on the ground, standing on its feet."""
        super()._start()
        config = self._surroundings
        self.scene = MujocoScene(config, mass=self._vehicle.mass)
        """MuJoCo's model and state."""
        moves = any((*config.initial_velocity, *config.initial_body_rates))
        if config.initial_position[2] == 0.0 and not moves:
            self._stand()
        self.scene.put(self._body)

    def _stand(self) -> None:
        """Tilt the vehicle like the ground, with its feet on the ground."""
        x, config = self._body[()], self._surroundings
        up = up_of(config.mujoco.ground)
        R_WB = so3.rotation_from_quaternion_xyzw(np.array(config.initial_attitude))
        R_WB = so3.exp(so3.shortest_turn_of_z(up)) @ R_WB
        place = np.array(config.initial_position)
        place[2] = -(place @ up) / up[2]
        x.q_WB_xyzw[:] = so3.quaternion_xyzw_from_rotation(R_WB)
        x.p_WC[:] = place + R_WB @ np.array(config.airframe.center_of_mass)

    def _is_on_ground(self) -> bool:
        """Whether the autopilot assumes a landing: contact of a foot, and little throttle."""
        thrust = self._vehicle.thrust(float(self._inputs["throttle"]))
        is_low = thrust < _LANDED_THRUST_RATIO * self._vehicle.mass * self._vehicle.gravity
        return is_low and self.scene.on_feet()

    def _coast(self, duration_ns: int) -> None:
        longest_ns = min(int(self._craft["longest_step_ns"]), _MAX_STEP_NS)
        while duration_ns > 0:
            step_ns = min(duration_ns, longest_ns)
            self._step(step_ns)
            duration_ns -= step_ns

    def _step(self, step_ns: int) -> None:
        """Advance the simulation by a step with constant commanded speeds."""
        has_ground_effect = self._surroundings.airframe.ground_effect > 0.0
        drive(
            self._body,
            speeds=self._speeds,
            wanted=self._wanted,
            inputs=self._inputs,
            craft=self._craft,
            rotors=self._rotors,
            ground=self.scene.ground_below(self._body["p_WC"]) if has_ground_effect else 0.0,
            duration=1e-9 * step_ns,
            out=self._drive,
        )
        self.scene.step(self._drive, self._body, at=1e-9 * self._moved_ns, duration=1e-9 * step_ns)
        self._moved_ns += step_ns
