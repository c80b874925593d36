"""The MuJoCo model of a configured plant, in MuJoCo's format (MJCF).

The frame of the vehicle's body is at its centre of mass C, so that MuJoCo integrates the state of
the plant ``rotors``. The name of a geom begins with the name of its object.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator

import numpy as np

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.simulation.mujoco_parameters import (
    ContactParameters,
    GroundParameters,
    MujocoParameters,
)

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
    root = ET.Element("mujoco", model="quad_mpc_ros")
    _settings(root, config)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 10", dir="0.2 0.1 -1", directional="true")
    _geom(
        world,
        GROUND,
        "plane",
        size=(0.0, 0.0, 1.0),
        pos=-config.airframe.clearance * up_of(config.mujoco.ground),
        quat=_wxyz(_rotation_of(config.mujoco.ground)),
        rgba=".75 .78 .75 1",
        group=str(SURFACES),
    )
    _vehicle(world, config, mass=mass)
    if config.mujoco.payload.mass > 0.0:
        _payload(root, world, config)
    if config.mujoco.deck.exists:
        _deck(world, config)
    _contacts(root, config.mujoco.contact)
    return ET.tostring(root, encoding="unicode")


def _settings(root: ET.Element, config: MujocoParameters) -> None:
    option = ET.SubElement(
        root,
        "option",
        gravity=_text((0.0, 0.0, -config.gravity)),
        integrator="RK4",
        cone="elliptic",  # friction alike in all directions
        impratio="100",  # a sticking vehicle does not creep
        tolerance="1e-10",
    )
    # A simulation that diverges must stay visible, not restart.
    ET.SubElement(option, "flag", autoreset="disable")
    # Only the contact pairs below can touch.
    ET.SubElement(ET.SubElement(root, "default"), "geom", contype="0", conaffinity="0")
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "global", offwidth="1920", offheight="1080")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.5 0.5 0.5")


def _vehicle(world: ET.Element, config: MujocoParameters, *, mass: float) -> None:
    airframe, rotors = config.airframe, config.rotors
    center = np.array(airframe.center_of_mass)
    body = ET.SubElement(world, "body", name=VEHICLE)
    ET.SubElement(body, "freejoint", name=VEHICLE)
    inertia = {"mass": _text((mass,)), "fullinertia": _text(airframe.inertia)}
    ET.SubElement(body, "inertial", inertia, pos="0 0 0")
    clearance = airframe.clearance
    for number, (x, y) in enumerate(_feet(config)):
        place = np.array([x, y, _FOOT_RADIUS - clearance]) - center
        _geom(
            body, f"{FOOT}{number}", "sphere", size=(_FOOT_RADIUS,), pos=place, rgba=".1 .1 .1 1"
        )
        ends = (*place, *(np.array([0.5 * x, 0.5 * y, 0.0]) - center))
        _geom(body, f"leg{number}", "capsule", size=(0.003,), fromto=ends, rgba=".3 .3 .3 1")
    span = np.array([max(np.ptp(rotors.x), 0.01), max(np.ptp(rotors.y), 0.01)])
    height = min(_HULL_HEIGHT * clearance, _HULL_SIZE * float(span.min()))
    size = (*(0.5 * _HULL_SIZE * span), 0.5 * height)
    middle = np.array([np.mean(rotors.x), np.mean(rotors.y), -0.5 * height]) - center
    _geom(body, HULL, "box", size=size, pos=middle, rgba=".2 .35 .7 1")
    for number, (x, y, z) in enumerate(zip(rotors.x, rotors.y, rotors.z, strict=True)):
        _geom(
            body,
            f"{ROTOR}{number}",
            "ellipsoid",  # MuJoCo finds cylinders parallel to a plane below the plane by rounding
            size=(rotors.radius, rotors.radius, 0.5 * _ROTOR_THICKNESS),
            pos=np.array([x, y, z]) - center,
            rgba=".9 .4 .2 .6" if x > 0.0 else ".5 .5 .5 .6",  # the front rotors are orange
        )
    hook = np.array(config.mujoco.payload.attachment) - center
    ET.SubElement(body, "site", name="hook", pos=_text(hook), size="0.002")


def _feet(config: MujocoParameters) -> Iterator[tuple[float, float]]:
    gear, rotors = config.mujoco.gear, config.rotors
    length = gear.length or float(np.ptp(rotors.x))
    width = gear.width or float(np.ptp(rotors.y))
    for x in (0.5 * length, -0.5 * length):
        for y in (0.5 * width, -0.5 * width):
            yield x, y


def _payload(root: ET.Element, world: ET.Element, config: MujocoParameters) -> None:
    payload = config.mujoco.payload
    body = ET.SubElement(world, "body", name=PAYLOAD)
    ET.SubElement(body, "freejoint", name=PAYLOAD)
    sphere = 0.4 * payload.mass * PAYLOAD_RADIUS**2
    inertia = {"mass": _text((payload.mass,)), "diaginertia": _text([sphere] * 3)}
    ET.SubElement(body, "inertial", inertia, pos="0 0 0")
    _geom(body, PAYLOAD, "sphere", size=(PAYLOAD_RADIUS,), rgba=".7 .1 .1 1")
    ET.SubElement(body, "site", name="eye", size="0.002")
    cable = ET.SubElement(
        ET.SubElement(root, "tendon"),
        "spatial",
        name=CABLE,
        limited="true",
        range=_text((0.0, payload.cable_length)),
        solreflimit=_text((_CABLE_TIME_CONSTANT, 1.0)),
        solimplimit=_text(_IMPEDANCE),
        width="0.003",
        rgba=".1 .1 .1 1",
    )
    for site in ("hook", "eye"):
        ET.SubElement(cable, "site", site=site)


def _deck(world: ET.Element, config: MujocoParameters) -> None:
    """Add the deck, with equal moments of inertia, so that its motions do not couple."""
    deck = config.mujoco.deck
    body = ET.SubElement(world, "body", name=DECK, pos=_text(deck.position), gravcomp="1")
    ET.SubElement(body, "joint", name=HEAVE, type="slide", axis="0 0 1")
    ET.SubElement(body, "joint", name=PITCH, type="hinge", axis="0 1 0")
    ET.SubElement(body, "joint", name=ROLL, type="hinge", axis="1 0 0")
    inertia = {"mass": _text((DECK_INERTIA,)), "diaginertia": _text([DECK_INERTIA] * 3)}
    ET.SubElement(body, "inertial", inertia, pos="0 0 0")
    length, width = deck.size
    _geom(
        body,
        DECK,
        "box",
        size=(0.5 * length, 0.5 * width, 0.5 * _DECK_THICKNESS),
        pos=(0.0, 0.0, -0.5 * _DECK_THICKNESS),
        rgba=".6 .65 .6 1",
        group=str(SURFACES),
    )


def _contacts(root: ET.Element, contact: ContactParameters) -> None:
    """Add the contact pairs of vehicle, load and surfaces."""
    names = [geom.get("name", "") for geom in root.iter("geom")]
    surfaces = [name for name in names if name.startswith((GROUND, DECK))]
    parts = [name for name in names if name.startswith((FOOT, HULL, ROTOR))]
    loads = [name for name in names if name == PAYLOAD]
    pairs = ET.SubElement(root, "contact")
    for first, second in [
        *itertools.product(surfaces, [*parts, *loads]),
        *itertools.product(parts, loads),
    ]:
        ET.SubElement(
            pairs,
            "pair",
            geom1=first,
            geom2=second,
            condim="3",
            friction=_text((contact.friction, contact.friction, 0.0, 0.0, 0.0)),
            solref=_text((contact.time_constant, contact.damping_ratio)),
            solreffriction=_text((-1.0, -_SLIP_RATE)),
            solimp=_text(_IMPEDANCE),
        )


def _geom(parent: ET.Element, name: str, kind: str, **attributes: str | Iterable[float]) -> None:
    texts = {
        key: value if isinstance(value, str) else _text(value) for key, value in attributes.items()
    }
    ET.SubElement(parent, "geom", texts, name=name, type=kind)


def _rotation_of(ground: GroundParameters) -> Array:
    """Return the rotation (3, 3) from level ground to the slope."""
    way = ground.slope_heading
    return so3.exp(ground.slope * np.array([np.sin(way), -np.cos(way), 0.0]))


def _wxyz(rotation: Array) -> Array:
    """Return a rotation (3, 3) as a quaternion w, x, y, z (4,), as MuJoCo expects it."""
    return np.roll(so3.quaternion_xyzw_from_rotation(rotation), 1)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
