# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo model of a configured plant, in MuJoCo's format (MJCF).

The frame of the vehicle's body is at its centre of mass C, so that MuJoCo integrates the state of
the plant ``rotors``. The name of a geom begins with the name of its object.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.simulation.optional_plants import GroundParameters, MujocoParameters

VEHICLE, PAYLOAD, DECK, CABLE = "vehicle", "payload", "deck", "cable"
HEAVE, PITCH, ROLL = "heave", "pitch", "roll"
FOOT, HULL, ROTOR, GROUND = "foot", "hull", "rotor", "ground"
SURFACES = 1
"""Group of the geoms on which a vehicle can stand: ground and deck."""
DECK_INERTIA = 1e4
"""Mass [kg] and inertia [kg m^2] of the deck, so large that contacts do not move it."""

_DECK_THICKNESS = 0.05  # m
_ROTOR_THICKNESS = 0.01  # m
_FOOT_RADIUS = 0.005  # m
PAYLOAD_RADIUS = 0.01  # m
# Shares of the rotors' distances and of the clearance: a box below the origin of the body.
_HULL_SIZE, _HULL_HEIGHT = 0.5, 0.4
# How the contact force grows with depth (MuJoCo's solimp): a standing vehicle sinks by
# (1 - d) / d g T^2 for the time constant T, a hundredth of a millimetre.
_IMPEDANCE = (0.95, 0.99, 0.001)
_CABLE_TIME_CONSTANT = 0.004  # s, of the limit of its length; four steps

# Slipping is slowed at this rate, up to the bound of friction [1/s]. With MuJoCo's default, 2 / T,
# a slipping vehicle would lift off and chatter, an effect of the convex contacts. With a lower
# rate a sticking vehicle would creep.
_SLIP_RATE = 20.0


def up_of(ground: GroundParameters) -> Array:
    """Return the upward normal (3,) of the ground in the world."""
    return np.asarray(_rotation_of(ground)[:, 2])


def model_of(config: MujocoParameters, *, mass: float) -> str:
    """Return the MJCF model for a vehicle with a true mass [kg]."""
    own = config.mujoco
    place = -config.airframe.clearance * up_of(own.ground)
    has_payload = own.payload.mass > 0.0
    return f"""
<mujoco model="quad_mpc_ros">
  <!-- elliptic: friction alike in all directions; impratio: a sticking vehicle does not creep -->
  <option gravity="0 0 {-config.gravity!r}" integrator="RK4" cone="elliptic" impratio="100"
      tolerance="1e-10">
    <!-- A simulation that diverges must stay visible, not restart. -->
    <flag autoreset="disable"/>
  </option>
  <default>
    <!-- Only the contact pairs below can touch. -->
    <geom contype="0" conaffinity="0"/>
  </default>
  <visual>
    <global offwidth="1920" offheight="1080"/>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.5 0.5 0.5"/>
  </visual>
  <worldbody>
    <light pos="0 0 10" dir="0.2 0.1 -1" directional="true"/>
    <geom name="{GROUND}" type="plane" size="0 0 1" pos="{_text(place)}"
        quat="{_text(_wxyz(_rotation_of(own.ground)))}" rgba=".75 .78 .75 1" group="{SURFACES}"/>
    {_vehicle(config, mass=mass)}
    {_payload(config) if has_payload else ""}
    {_deck(config) if own.deck.exists else ""}
  </worldbody>
  {_cable(config) if has_payload else ""}
  <contact>
    {_contact_pairs(config)}
  </contact>
</mujoco>"""


def _vehicle(config: MujocoParameters, *, mass: float) -> str:
    airframe, rotors, gear = config.airframe, config.rotors, config.mujoco.gear
    center, clearance = np.array(airframe.center_of_mass), airframe.clearance
    geoms = []
    length, width = gear.length or np.ptp(rotors.x), gear.width or np.ptp(rotors.y)
    feet = itertools.product((0.5 * length, -0.5 * length), (0.5 * width, -0.5 * width))
    for number, (x, y) in enumerate(feet):
        place = np.array([x, y, _FOOT_RADIUS - clearance]) - center
        ends = (*place, *(np.array([0.5 * x, 0.5 * y, 0.0]) - center))
        geoms.append(f"""
      <geom name="{FOOT}{number}" type="sphere" size="{_FOOT_RADIUS}" pos="{_text(place)}"
          rgba=".1 .1 .1 1"/>
      <geom name="leg{number}" type="capsule" size="0.003" fromto="{_text(ends)}"
          rgba=".3 .3 .3 1"/>""")
    span = np.array([max(np.ptp(rotors.x), 0.01), max(np.ptp(rotors.y), 0.01)])
    height = min(_HULL_HEIGHT * clearance, _HULL_SIZE * float(span.min()))
    middle = np.array([np.mean(rotors.x), np.mean(rotors.y), -0.5 * height]) - center
    geoms.append(f"""
      <geom name="{HULL}" type="box" size="{_text((*(0.5 * _HULL_SIZE * span), 0.5 * height))}"
          pos="{_text(middle)}" rgba=".2 .35 .7 1"/>""")
    # Ellipsoids: MuJoCo finds cylinders parallel to a plane below the plane by rounding.
    size = (rotors.radius, rotors.radius, 0.5 * _ROTOR_THICKNESS)
    for number, (x, y, z) in enumerate(zip(rotors.x, rotors.y, rotors.z, strict=True)):
        colour = ".9 .4 .2 .6" if x > 0.0 else ".5 .5 .5 .6"  # the front rotors are orange
        geoms.append(f"""
      <geom name="{ROTOR}{number}" type="ellipsoid" size="{_text(size)}"
          pos="{_text(np.array([x, y, z]) - center)}" rgba="{colour}"/>""")
    hook = np.array(config.mujoco.payload.attachment) - center
    return f"""
    <body name="{VEHICLE}">
      <freejoint name="{VEHICLE}"/>
      <inertial mass="{mass!r}" fullinertia="{_text(airframe.inertia)}" pos="0 0 0"/>
      {"".join(geoms)}
      <site name="hook" pos="{_text(hook)}" size="0.002"/>
    </body>"""


def _payload(config: MujocoParameters) -> str:
    mass = config.mujoco.payload.mass
    return f"""
    <body name="{PAYLOAD}">
      <freejoint name="{PAYLOAD}"/>
      <inertial mass="{mass!r}" diaginertia="{_text([0.4 * mass * PAYLOAD_RADIUS**2] * 3)}"
          pos="0 0 0"/>
      <geom name="{PAYLOAD}" type="sphere" size="{PAYLOAD_RADIUS}" rgba=".7 .1 .1 1"/>
      <site name="eye" size="0.002"/>
    </body>"""


def _cable(config: MujocoParameters) -> str:
    return f"""
  <tendon>
    <spatial name="{CABLE}" limited="true" range="0 {config.mujoco.payload.cable_length!r}"
        solreflimit="{_CABLE_TIME_CONSTANT} 1" solimplimit="{_text(_IMPEDANCE)}" width="0.003"
        rgba=".1 .1 .1 1">
      <site site="hook"/>
      <site site="eye"/>
    </spatial>
  </tendon>"""


def _deck(config: MujocoParameters) -> str:
    """Return the deck, with equal moments of inertia, so that its motions do not couple."""
    deck = config.mujoco.deck
    size = (0.5 * deck.size[0], 0.5 * deck.size[1], 0.5 * _DECK_THICKNESS)
    return f"""
    <body name="{DECK}" pos="{_text(deck.position)}" gravcomp="1">
      <joint name="{HEAVE}" type="slide" axis="0 0 1"/>
      <joint name="{PITCH}" type="hinge" axis="0 1 0"/>
      <joint name="{ROLL}" type="hinge" axis="1 0 0"/>
      <inertial mass="{DECK_INERTIA}" diaginertia="{_text([DECK_INERTIA] * 3)}" pos="0 0 0"/>
      <geom name="{DECK}" type="box" size="{_text(size)}" pos="0 0 {-0.5 * _DECK_THICKNESS}"
          rgba=".6 .65 .6 1" group="{SURFACES}"/>
    </body>"""


def _contact_pairs(config: MujocoParameters) -> str:
    """Return the contact pairs of vehicle, load and surfaces."""
    contact = config.mujoco.contact
    surfaces = [GROUND, *([DECK] if config.mujoco.deck.exists else [])]
    rotors = [f"{ROTOR}{number}" for number in range(len(config.rotors.x))]
    parts = [*(f"{FOOT}{number}" for number in range(4)), HULL, *rotors]
    loads = [PAYLOAD] if config.mujoco.payload.mass > 0.0 else []
    pairs = [*itertools.product(surfaces, [*parts, *loads]), *itertools.product(parts, loads)]
    friction = (contact.friction, contact.friction, 0.0, 0.0, 0.0)
    return "".join(
        f"""
    <pair geom1="{first}" geom2="{second}" condim="3" friction="{_text(friction)}"
        solref="{_text((contact.time_constant, contact.damping_ratio))}"
        solreffriction="-1 {-_SLIP_RATE}" solimp="{_text(_IMPEDANCE)}"/>"""
        for first, second in pairs
    )


def _rotation_of(ground: GroundParameters) -> Array:
    """Return the rotation (3, 3) from level ground to the slope."""
    way = ground.slope_heading
    return so3.exp(ground.slope * np.array([np.sin(way), -np.cos(way), 0.0]))


def _wxyz(rotation: Array) -> Array:
    """Return a rotation (3, 3) as a quaternion w, x, y, z (4,), as MuJoCo expects it."""
    return np.roll(so3.quaternion_xyzw_from_rotation(rotation), 1)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
