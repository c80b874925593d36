"""The vehicle among what there is to touch, as MuJoCo moves it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.plants.mujoco import deck, model
from quad_mpc_ros.extras.plants.mujoco.drive import Drive
from quad_mpc_ros.extras.plants.mujoco.installation import mujoco_module
from quad_mpc_ros.simulation.mujoco_parameters import MujocoParameters
from quad_mpc_ros.simulation.rotors.state import BodyState

# Of the coordinates of a free joint: place and attitude, velocity in the world, rates in the body.
_POSITION, _ATTITUDE_WXYZ = slice(0, 3), slice(3, 7)
_LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)
_XYZW = [1, 2, 3, 0]  # of w, x, y, z
_DOWN = np.array([0.0, 0.0, -1.0])
_MAX_OVERLAP = 1e-3  # m that things may overlap at the start
_GROUP_COUNT = 6  # of geoms in MuJoCo
_AXIS_COUNT, _WRENCH_SIZE = 3, 6


class MujocoScene:
    """MuJoCo's model and state; times in seconds from the start of the plant."""

    def __init__(self, config: MujocoParameters, *, mass: float) -> None:
        """Build it for a vehicle of a true mass [kg].

        Raises :class:`UserError` where MuJoCo is not installed, :class:`ConfigurationError` for an
        inertia that no body has.
        """
        self._mujoco = mujoco_module()
        self.mjcf = model.model_of(config, mass=mass)
        """The model in MuJoCo's format, which its viewer opens."""
        try:
            self.model: Any = self._mujoco.MjModel.from_xml_string(self.mjcf)
        except ValueError as error:  # the rest of the model cannot be wrong
            raise ConfigurationError(
                "simulator.airframe.inertia",
                config.airframe.inertia,
                f"one that MuJoCo takes ({' '.join(str(error).split())})",
            ) from error
        self.data: Any = self._mujoco.MjData(self.model)
        self._config = config
        vehicle = self.data.joint(model.VEHICLE)
        self._place, self._attitude = vehicle.qpos[_POSITION], vehicle.qpos[_ATTITUDE_WXYZ]
        self._velocity, self._rates = vehicle.qvel[_LINEAR], vehicle.qvel[_ANGULAR]
        self._force = vehicle.qfrc_applied[_LINEAR]
        self._torque = vehicle.qfrc_applied[_ANGULAR]
        self._carrying = np.zeros(_GROUP_COUNT, np.uint8)
        self._carrying[model.SURFACES] = 1
        self._geom_names = [self.model.geom(k).name for k in range(self.model.ngeom)]
        self._is_part = np.array(
            [name.startswith((model.FOOT, model.HULL, model.ROTOR)) for name in self._geom_names]
        )
        self._is_foot = np.array([name.startswith(model.FOOT) for name in self._geom_names])
        self._touched = np.zeros(self.model.ngeom, bool)
        self._sways = self._deck_joints()

    def put(self, body: RecordArray[BodyState], *, seconds: float) -> None:
        """Put the vehicle where a state says, and the load below it, at rest with it.

        Raises :class:`ConfigurationError` where something would begin inside of something else.
        """
        self._place[:], self._velocity[:] = body["p_WC"], body["v_WC_W"]
        self._attitude[:] = np.roll(body["q_WB_xyzw"], 1)
        self._rates[:] = body["w_WB_B"]
        self._move_deck(seconds, duration=self.model.opt.timestep)
        if self._config.mujoco.payload.mass > 0.0:
            self._hang_payload()
        self._mujoco.mj_forward(self.model, self.data)
        for contact in self.data.contact:
            if contact.dist < -_MAX_OVERLAP:
                first, second = (self._geom_names[geom] for geom in contact.geom)
                raise ConfigurationError(
                    "simulator.initial_position",
                    self._config.initial_position,
                    f"a start at which nothing overlaps: {first} and {second} do by "
                    f"{-contact.dist:.3f} m",
                )

    def step(
        self,
        drive: RecordArray[Drive],
        body: RecordArray[BodyState],
        *,
        at: float,
        duration: float,
    ) -> None:
        """Move everything over a step that begins at a time; write the vehicle's state.

        Raises :class:`UserError` when the motion diverges.
        """
        self._force[:], self._torque[:] = drive["force_W"], drive["torque_B"]
        self.model.opt.timestep = duration
        self._move_deck(at, duration=duration)
        self._mujoco.mj_step(self.model, self.data)
        self._touched[self.data.contact.geom] = True
        body["p_WC"], body["v_WC_W"] = self._place, self._velocity
        body["q_WB_xyzw"], body["w_WB_B"] = self._attitude[_XYZW], self._rates
        if not math.isfinite(self._place.sum()):
            raise UserError(
                f"simulator.mujoco: the motion diverges at {at:.3f} s; try a longer "
                "mujoco.contact.time_constant or a shorter advanced.integration_step"
            )

    def ground_below(self, p_WC: Array) -> float:
        """Return the height of the origin of a vehicle that stands below a place (3,) [m]."""
        geom = np.zeros(1, np.int32)
        distance = self._mujoco.mj_ray(
            self.model, self.data, p_WC, _DOWN, self._carrying, True, -1, geom
        )
        return float(p_WC[2] - max(distance, 0.0) + self._config.airframe.clearance)

    def touching(self) -> frozenset[str]:
        """Return which parts of the vehicle touch anything: ``foot0``, ``hull``, ``rotor2``…"""
        return self._parts_of(np.unique(self.data.contact.geom))

    def touched(self) -> frozenset[str]:
        """Return which have since this was asked last; a bounce is over in milliseconds."""
        geoms = np.flatnonzero(self._touched)
        self._touched[:] = False
        return self._parts_of(geoms)

    def _parts_of(self, geoms: NDArray[np.intp]) -> frozenset[str]:
        return frozenset(self._geom_names[geom] for geom in geoms if self._is_part[geom])

    def on_feet(self) -> bool:
        """Return whether a foot touches anything."""
        return bool(self._is_foot[self.data.contact.geom].any())

    def contact_force(self) -> Array:
        """Return the force (3,) of all contacts on the vehicle, in the world [N]."""
        total, wrench = np.zeros(3), np.zeros(_WRENCH_SIZE)
        for number, contact in enumerate(self.data.contact):
            self._mujoco.mj_contactForce(self.model, self.data, number, wrench)
            # In the frame of the contact, whose rows are its axes, from the first to the second.
            force_W = contact.frame.reshape(_AXIS_COUNT, _AXIS_COUNT).T @ wrench[_LINEAR]
            first, second = contact.geom
            total += force_W * (int(self._is_part[second]) - int(self._is_part[first]))
        return total

    def cable_tension(self) -> float:
        """Return the force in the cable [N]; 0 without one."""
        kind = self._mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON
        return float(self.data.efc_force[self.data.efc_type == kind].sum())

    def payload_place(self) -> Array:
        """Return where the middle of the load is (3,) [m]; raises ``KeyError`` without one."""
        return np.array(self.data.body(model.PAYLOAD).xpos)

    def _deck_joints(self) -> list[tuple[Any, deck.Sine]]:
        """Return each joint of the deck with its motion."""
        given = self._config.mujoco.deck
        if not given.exists:
            return []
        sines = {
            model.HEAVE: deck.heave(given),
            model.PITCH: deck.pitch(given),
            model.ROLL: deck.roll(given),
        }
        return [(self.data.joint(name), sine) for name, sine in sines.items()]

    def _move_deck(self, seconds: float, *, duration: float) -> None:
        """Put the deck where it is at a time, and push it as it moves over the next step."""
        for joint, sine in self._sways:
            sway = sine.at(seconds, duration=duration)
            joint.qpos[:], joint.qvel[:] = sway.value, sway.rate
            joint.qfrc_applied[:] = model.DECK_INERTIA * sway.acceleration

    def _hang_payload(self) -> None:
        """Put the load below the vehicle: at the cable's end, or on what is above that."""
        given = self._config.mujoco.payload
        self._mujoco.mj_kinematics(self.model, self.data)
        hook = np.array(self.data.site("hook").xpos)
        surface = self.ground_below(hook) - self._config.airframe.clearance
        place = hook + _DOWN * min(given.cable_length, hook[2] - surface - given.radius)
        payload = self.data.joint(model.PAYLOAD)
        payload.qpos[:] = [*place, 1.0, 0.0, 0.0, 0.0]
        payload.qvel[_LINEAR] = self._velocity
