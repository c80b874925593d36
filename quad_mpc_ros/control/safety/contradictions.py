# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The most likely cause of a contradiction: the known mistake that fits the measurements best.

Each mistake predicts the matrix M of y = M x for every relation of :mod:`.consistency`, for a
level vehicle with heading x. The most likely mistake has the smallest sum of squares

    sum of |y - M x|^2 = tr(S_yy - 2 M S_yx' + M S_xx M'),

relative to the total of the relation. Among mistakes with equal fit, the mistake that changes
fewer relations is more likely.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.safety.comparison import ConsistencyState, Relation
from quad_mpc_ros.control.safety.relations import trace

_IDENTITY, _ZERO, _NEGATED = np.eye(3), np.zeros((3, 3)), -np.eye(3)
_FLU_FRD = np.diag([1.0, -1.0, -1.0])
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_SWAP_XY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_TURN_LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_WXYZ = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_TURN_AROUND = np.diag([-1.0, -1.0, 1.0])
_FLIP_X, _FLIP_Y, _FLIP_Z = (
    np.diag([-1.0, 1.0, 1.0]),
    np.diag([1.0, -1.0, 1.0]),
    np.diag([1.0, 1.0, -1.0]),
)
_AXES = (("roll", _FLIP_X), ("pitch", _FLIP_Y), ("yaw", _FLIP_Z))
_IN_DEGREES, _IN_CENTIMETRES = np.degrees(1.0) * _IDENTITY, 100.0 * _IDENTITY
_EXPECTED_FRAMES = "expected ENU world and FLU body"


class _Mistake(NamedTuple):
    """A mistake, and the matrices of the relations that it changes."""

    cause: str
    gains: Mapping[str, Array]
    z_is_mirrored: bool = False
    """Whether the vertical axis is reversed."""


_MISTAKES = (
    _Mistake(
        f"z and thrust disagree: is the odometry in NED and FRD? {_EXPECTED_FRAMES}",
        {"rates": _FLU_FRD, "force": _NEGATED},
        z_is_mirrored=True,
    ),
    _Mistake(
        f"the position disagrees with the velocity: is the position in NED? {_EXPECTED_FRAMES}",
        {"position": _ENU_NED},
    ),
    _Mistake(
        f"twist and attitude disagree: is the twist in FRD? {_EXPECTED_FRAMES}",
        {"attitude": _FLU_FRD, "position": _FLU_FRD, "rates": _FLU_FRD, "force": _FLU_FRD},
        z_is_mirrored=True,
    ),
    _Mistake(
        f"attitude and thrust disagree: is the body frame FRD? {_EXPECTED_FRAMES}",
        {"rates": _FLU_FRD, "force": _NEGATED},
    ),
    _Mistake(
        f"attitude and thrust disagree: is the attitude in NED? {_EXPECTED_FRAMES}",
        {"force": _NEGATED},
    ),
    _Mistake(
        "z and thrust disagree: does z of the odometry point down?", {"force": _FLIP_Z}, True
    ),
    _Mistake("z disagrees with the velocity: does z point down?", {"position": _FLIP_Z}),
    _Mistake("x and tilt disagree: is x of the odometry reversed?", {"force": _FLIP_X}),
    _Mistake("y and tilt disagree: is y of the odometry reversed?", {"force": _FLIP_Y}),
    _Mistake("x disagrees with the velocity: is it reversed?", {"position": _FLIP_X}),
    _Mistake("y disagrees with the velocity: is it reversed?", {"position": _FLIP_Y}),
    _Mistake("x, y and tilt disagree: are x and y swapped?", {"force": _SWAP_XY}),
    _Mistake("x and y disagree with the velocity: are they swapped?", {"position": _SWAP_XY}),
    *(
        _Mistake(
            f"heading and {what} disagree: is the heading off by {angle} degrees, or is "
            "odometry.twist_frame wrong?",
            {relation: turn},
        )
        for angle, turn in (("90", _TURN_LEFT), ("-90", _TURN_LEFT.T), ("180", _TURN_AROUND))
        for what, relation in (("velocity", "position"), ("acceleration", "force"))
    ),
    _Mistake(
        "attitude and body rates disagree: is the quaternion in the order w, x, y, z? expected "
        "x, y, z, w",
        {"attitude": _WXYZ, "position": _FLU_FRD, "force": np.diag([1.0, 0.0, -1.0])},
    ),
    _Mistake(
        "attitude and body rates disagree: is the attitude inverted (world to body, conjugated)?",
        {"attitude": _NEGATED, "force": _TURN_AROUND},
    ),
    _Mistake(
        "body rates are too large for the attitude: are they in deg/s? expected rad/s",
        {"attitude": _IN_DEGREES, "rates": _IN_DEGREES},
    ),
    _Mistake(
        "body rates are zero while the attitude turns: does the source not fill them in?",
        {"attitude": _ZERO, "rates": _ZERO},
    ),
    _Mistake(
        "attitude and body rates disagree: is the sign of the rates reversed?",
        {"attitude": _NEGATED, "rates": _NEGATED},
    ),
    *(
        _Mistake(
            f"attitude and {name} rate disagree: is the sign of the {name} rate reversed?",
            {"attitude": flip, "rates": flip},
        )
        for name, flip in _AXES
    ),
    _Mistake(
        "velocity and position disagree: is the sign of the velocity reversed?",
        {"position": _NEGATED, "force": _NEGATED},
        z_is_mirrored=True,
    ),
    _Mistake(
        "the velocity is zero while the position changes: does the source not fill it in?",
        {"position": _ZERO, "force": _ZERO},
    ),
    _Mistake(
        "the velocity is too large for the position: is it in cm/s? expected m/s",
        {"position": _IN_CENTIMETRES, "force": _IN_CENTIMETRES},
    ),
    *(
        _Mistake(
            f"the position changes too fast for the velocity: is it in {unit}? expected m",
            {"position": share * _IDENTITY},
        )
        for unit, share in (("cm", 0.01), ("mm", 0.001), ("feet", 0.3048))
    ),
    *(
        _Mistake(
            f"the vehicle turns against the commanded {name} rate: is its sign reversed on the "
            "way to the motors?",
            {"rates": flip},
        )
        for name, flip in _AXES
    ),
    _Mistake(
        "the vehicle responds to roll commands with pitch: are the axes swapped on the way to the "
        "motors, or is a rotor blocked?",
        {"rates": _SWAP_XY},
    ),
    _Mistake(
        "the vehicle does not follow the commanded body rates: are the commands received, is a "
        "rotor blocked, is the vehicle held?",
        {"rates": _ZERO},
    ),
    _Mistake(
        "the vehicle does not follow the thrust: is a motor, a propeller or the battery missing, "
        "is the vehicle held?",
        {"force": _ZERO},
    ),
)


_NO_LIFT = (
    "z and thrust disagree: does z of the odometry point down (NED, expected ENU), or is a motor, "
    "a propeller or the battery missing?"
)
_NO_DESCENT = (
    "z and thrust disagree: the vehicle climbs without commanded thrust: is the throttle reversed "
    "on the way to the motors, or is thrust_curve wrong?"
)
_COST_PER_RELATION = 0.18
_MIN_LIFT = 0.1  # of the weight
_MIN_SQUARES = {"attitude": 0.01, "position": 0.02, "rates": 0.02, "force": 0.1}


def likely_cause(found: int, state: ConsistencyState) -> str:
    """Return the most likely cause as text, and what to check.

    Args:
        found: Contradicted relations; the cause explains at least one.
        state: State of the comparison.
    """
    if found == Relation.LIFT:
        # A reversed velocity looks like a fall.
        if trace(state.position.yx) >= -0.5 * trace(state.position.xx):
            return _NO_LIFT
        found |= Relation.POSITION
    if found == Relation.CLIMB:
        return _NO_DESCENT
    mistakes = [
        mistake
        for mistake in _MISTAKES
        if any(found & Relation[name.upper()] for name in mistake.gains)
    ]
    return min(mistakes, key=lambda mistake: _misfit(mistake, state)).cause


def _misfit(mistake: _Mistake, state: ConsistencyState) -> float:
    """Return the share of the measured motion that a mistake does not explain."""
    misfit, gravity = _COST_PER_RELATION * len(mistake.gains), state.model.gravity
    for name, least in _MIN_SQUARES.items():
        pair, gain = getattr(state, name), mistake.gains.get(name, _IDENTITY)
        left = np.trace(pair.yy - 2.0 * gain @ pair.yx.T + gain @ pair.xx @ gain.T)
        misfit += float(left / (np.trace(pair.yy) + np.trace(gain @ pair.xx @ gain.T) + least))
    asked, measured = float(state.force.x[2] / gravity), float(state.force.y[2] / gravity)
    gain_z = float(mistake.gains.get("force", _IDENTITY)[2, 2])
    expected = 2.0 - asked if mistake.z_is_mirrored else gain_z * asked
    return misfit + abs(measured - expected) / (abs(measured) + abs(expected) + _MIN_LIFT)
