# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle and the objects around it, simulated by MuJoCo."""

from __future__ import annotations

import importlib
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.plants.mujoco import model
from quad_mpc_ros.extras.plants.mujoco.drive import Drive
from quad_mpc_ros.simulation.optional_plants import MujocoParameters
from quad_mpc_ros.simulation.rotors.craft import BodyState

# Coordinates of a free joint: position and attitude; velocity in the world, rates in the body.
_POSITION, _ATTITUDE_WXYZ = slice(0, 3), slice(3, 7)
_LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)
_XYZW = [1, 2, 3, 0]  # of w, x, y, z
_DOWN = np.array([0.0, 0.0, -1.0])
_MAX_OVERLAP = 1e-3  # m, at the start
_GROUP_COUNT = 6  # of geoms in MuJoCo


class _Sine(NamedTuple):
    """amplitude sin(2 pi frequency t + phase); in m or rad, Hz, rad."""

    amplitude: float
    frequency: float
    phase: float

    def value(self, seconds: float) -> float:
        """Return the value at a time [s]."""
        return self.amplitude * math.sin(math.tau * self.frequency * seconds + self.phase)

    def rate(self, seconds: float) -> float:
        """Return the derivative at a time [s]."""
        omega = math.tau * self.frequency
        return self.amplitude * omega * math.cos(omega * seconds + self.phase)


class MujocoScene:
    """MuJoCo's model and state; times in seconds from the start of the plant."""

    def __init__(self, config: MujocoParameters, *, mass: float) -> None:
        """Build the model for a vehicle with a true mass [kg].

        Raises :class:`UserError` if MuJoCo is not installed, :class:`ConfigurationError` for an
        impossible inertia.
        """
        self._mujoco = _mujoco_module()
        self.mjcf = model.model_of(config, mass=mass)
        """The model in MuJoCo's format, for MuJoCo's viewer."""
        try:
            self.model: Any = self._mujoco.MjModel.from_xml_string(self.mjcf)
        except ValueError as error:  # the rest of the model cannot be wrong
            raise ConfigurationError(
                "simulator.airframe.inertia",
                config.airframe.inertia,
                f"an inertia that MuJoCo accepts ({' '.join(str(error).split())})",
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
        deck = config.mujoco.deck
        motions = {
            model.HEAVE: _Sine(deck.heave_amplitude, deck.heave_frequency, deck.heave_phase),
            model.PITCH: _Sine(deck.pitch_amplitude, deck.rock_frequency, deck.pitch_phase),
            model.ROLL: _Sine(deck.roll_amplitude, deck.rock_frequency, deck.roll_phase),
        }
        self._deck_joints = [
            (self.data.joint(name), sine) for name, sine in motions.items() if deck.exists
        ]

    def put(self, body: RecordArray[BodyState]) -> None:
        """Set the initial state of the vehicle, with the load at rest below it.

        Raises :class:`ConfigurationError` if objects overlap.
        """
        self._place[:], self._velocity[:] = body["p_WC"], body["v_WC_W"]
        self._attitude[:] = np.roll(body["q_WB_xyzw"], 1)
        self._rates[:] = body["w_WB_B"]
        self._move_deck(0.0, duration=self.model.opt.timestep)
        if self._config.mujoco.payload.mass > 0.0:
            self._hang_payload()
        self._mujoco.mj_forward(self.model, self.data)
        for contact in self.data.contact:
            if contact.dist < -_MAX_OVERLAP:
                first, second = (self._geom_names[geom] for geom in contact.geom)
                raise ConfigurationError(
                    "simulator.initial_position",
                    self._config.initial_position,
                    f"a start without overlaps: {first} and {second} overlap by "
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
        """Advance the simulation by a step from a time [s] on; write the vehicle's state.

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
        """Return the height [m] of the origin of a vehicle standing below a position (3,) [m]."""
        geom = np.zeros(1, np.int32)
        distance = self._mujoco.mj_ray(
            self.model, self.data, p_WC, _DOWN, self._carrying, True, -1, geom
        )
        return float(p_WC[2] - max(distance, 0.0) + self._config.airframe.clearance)

    def touching(self) -> frozenset[str]:
        """Return the parts of the vehicle in contact: ``foot0``, ``hull``, ``rotor2``…"""
        return self._parts_of(np.unique(self.data.contact.geom))

    def touched(self) -> frozenset[str]:
        """Return the parts in contact since the last call; a bounce takes milliseconds."""
        geoms = np.flatnonzero(self._touched)
        self._touched[:] = False
        return self._parts_of(geoms)

    def _parts_of(self, geoms: NDArray[np.intp]) -> frozenset[str]:
        return frozenset(self._geom_names[geom] for geom in geoms if self._is_part[geom])

    def on_feet(self) -> bool:
        """Return whether a foot touches anything."""
        return bool(self._is_foot[self.data.contact.geom].any())

    def _move_deck(self, seconds: float, *, duration: float) -> None:
        """Set the deck's state at a time, and the force that moves it over the next step."""
        for joint, sine in self._deck_joints:
            rate, rate_after = sine.rate(seconds), sine.rate(seconds + duration)
            joint.qpos[:], joint.qvel[:] = sine.value(seconds), rate
            joint.qfrc_applied[:] = model.DECK_INERTIA * ((rate_after - rate) / duration)

    def _hang_payload(self) -> None:
        """Place the load below the vehicle, at the end of the cable or on the surface below."""
        length = self._config.mujoco.payload.cable_length
        self._mujoco.mj_kinematics(self.model, self.data)
        hook = np.array(self.data.site("hook").xpos)
        surface = self.ground_below(hook) - self._config.airframe.clearance
        place = hook + _DOWN * min(length, hook[2] - surface - model.PAYLOAD_RADIUS)
        payload = self.data.joint(model.PAYLOAD)
        payload.qpos[:] = [*place, 1.0, 0.0, 0.0, 0.0]
        payload.qvel[_LINEAR] = self._velocity


def _mujoco_module() -> Any:
    """Return the module ``mujoco``; raises :class:`UserError` if not installed."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise UserError(
            f"simulator.plant: mujoco cannot be imported ({error}); "
            "install it with: pip install 'quad_mpc_ros[mujoco]'"
        ) from error
