"""The plant ``mujoco``."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.extras.plants.mujoco import drive
from quad_mpc_ros.extras.plants.mujoco.model import up_of
from quad_mpc_ros.extras.plants.mujoco.scene import MujocoScene
from quad_mpc_ros.simulation.mujoco_parameters import MujocoParameters
from quad_mpc_ros.simulation.rotors.plant import RotorsPlant

_MAX_STEP_NS = 1_000_000  # half of the least time constant of a contact
# An autopilot takes itself to stand when it touches and is asked for little of its weight.
_LANDED_THRUST_RATIO = 0.5


class MujocoPlant(RotorsPlant):
    """The plant ``rotors`` with ground, deck, walls, gear and load as MuJoCo has them.

    Rotors, air and rate loop are those of the plant ``rotors``; nothing holds the vehicle level,
    and nothing stops it but what it touches. It begins standing where ``initial_position`` is at
    height 0 and nothing moves: its feet then are on the ground, whatever the slope.
    """

    def __init__(self, config: MujocoParameters) -> None:
        """Build the scene; raises :class:`UserError` where MuJoCo is not installed."""
        self._surroundings = config
        self._drive = drive.Drive.zeros()
        self._moved_ns = 0
        super().__init__(config)

    @property
    def touching(self) -> frozenset[str]:
        """Parts of the vehicle that touch anything: ``foot0``, ``hull``, ``rotor2``…"""
        return self.scene.touching()

    @property
    def contact_force_W(self) -> Array:
        """Force (3,) of all contacts on the vehicle [N]."""
        return self.scene.contact_force()

    @property
    def cable_tension(self) -> float:
        """Force in the cable of the load [N]; 0 without one."""
        return self.scene.cable_tension()

    def _start(self) -> None:
        """Begin where the parameters say; on the ground, standing on its feet."""
        super()._start()
        self.scene = MujocoScene(self._surroundings, mass=self._vehicle.mass)
        """MuJoCo's model and state."""
        given = self._surroundings
        moves = any((*given.initial_velocity, *given.initial_body_rates))
        if given.initial_position[2] == 0.0 and not moves:
            self._stand()
        self.scene.put(self._body, seconds=0.0)

    def _stand(self) -> None:
        """Lean the vehicle as the ground does, its origin above the ground where it is put."""
        x, given = self._body[()], self._surroundings
        up = up_of(given.mujoco.ground)
        R_WB = so3.rotation_from_quaternion_xyzw(np.array(given.initial_attitude))
        R_WB = so3.exp(so3.shortest_turn_of_z(up)) @ R_WB
        place = np.array(given.initial_position)
        place[2] = -(place @ up) / up[2]
        x.q_WB_xyzw[:] = so3.quaternion_xyzw_from_rotation(R_WB)
        x.p_WC[:] = place + R_WB @ np.array(given.airframe.center_of_mass)

    def _move(self, *, duration_ns: int) -> None:
        longest_ns = min(int(self._craft["longest_step_ns"]), _MAX_STEP_NS)
        memory = self._memory[()]
        while duration_ns > 0:
            if memory.until_run_ns == 0:
                self._command()
                memory.until_run_ns = self._loop[()].period_ns
            step_ns = min(duration_ns, int(memory.until_run_ns), longest_ns)
            self._step(step_ns)
            memory.until_run_ns -= step_ns
            duration_ns -= step_ns

    def _command(self) -> None:
        """Let the rate loop run."""
        asked = self._vehicle.thrust(float(self._inputs["throttle"]))
        little = asked < _LANDED_THRUST_RATIO * self._vehicle.mass * self._vehicle.gravity
        drive.command(
            self._memory,
            body=self._body,
            inputs=self._inputs,
            on_ground=little and self.scene.on_feet(),
            loop=self._loop,
            mix=self._mix,
            wanted=self._wanted,
        )

    def _step(self, step_ns: int) -> None:
        """Move everything by a step in which the wanted speeds stay."""
        in_effect = self._surroundings.airframe.ground_effect > 0.0
        drive.drive(
            self._body,
            speeds=self._speeds,
            wanted=self._wanted,
            inputs=self._inputs,
            craft=self._craft,
            rotors=self._rotors,
            ground=self.scene.ground_below(self._body["p_WC"]) if in_effect else 0.0,
            duration=1e-9 * step_ns,
            out=self._drive,
        )
        self.scene.step(self._drive, self._body, at=1e-9 * self._moved_ns, duration=1e-9 * step_ns)
        self._moved_ns += step_ns
