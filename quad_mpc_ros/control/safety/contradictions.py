"""The most likely cause of a contradiction: which known mistake explains what was measured.

Each mistake predicts the matrix M of y = M x for every relation of :mod:`.consistency`, for a
vehicle near level that heads along x. The likeliest is the one with the smallest sum of squares

    sum of |y - M x|^2 = tr(S_yy - 2 M S_yx' + M S_xx M'),

relative to what the relation holds in all, so that a relation with little motion says little. Of
two that explain it equally well the one that changes fewer relations is the likelier.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.lie import Array


class Sums(NamedTuple):
    """Weighted sums of products of a relation, each (3, 3): S_xx, S_yx, S_yy."""

    xx: Array
    yx: Array
    yy: Array


def _diagonal(x: float, y: float, z: float) -> Array:
    return np.diag([x, y, z])


_SAME, _NOTHING, _BACK = np.eye(3), np.zeros((3, 3)), -np.eye(3)
_FLU_FRD = _diagonal(1.0, -1.0, -1.0)
_ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_WXYZ = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_AROUND = _diagonal(-1.0, -1.0, 1.0)
_X, _Y, _Z = _diagonal(-1.0, 1.0, 1.0), _diagonal(1.0, -1.0, 1.0), _diagonal(1.0, 1.0, -1.0)
_DEGREES, _CENTI = np.degrees(1.0) * _SAME, 100.0 * _SAME
_ODOMETRY = "expected ENU world and FLU body"


class _Mistake(NamedTuple):
    """A mistake, and the matrix of each relation that it makes other than the identity."""

    cause: str
    gains: Mapping[str, Array]
    z_is_mirrored: bool = False
    """Whether up is reported as down, and gravity with it."""


_MISTAKES = (
    _Mistake(
        f"z and thrust disagree: is the odometry in NED and FRD? {_ODOMETRY}",
        {"rates": _FLU_FRD, "force": _BACK},
        z_is_mirrored=True,
    ),
    _Mistake(
        f"the position disagrees with the velocity: is the position in NED? {_ODOMETRY}",
        {"position": _ENU_NED},
    ),
    _Mistake(
        f"twist and attitude disagree: is the twist in FRD? {_ODOMETRY}",
        {"attitude": _FLU_FRD, "position": _FLU_FRD, "rates": _FLU_FRD, "force": _FLU_FRD},
        z_is_mirrored=True,
    ),
    _Mistake(
        f"attitude and thrust disagree: is the body frame FRD? {_ODOMETRY}",
        {"rates": _FLU_FRD, "force": _BACK},
    ),
    _Mistake(
        f"attitude and thrust disagree: is the attitude in NED? {_ODOMETRY}", {"force": _BACK}
    ),
    _Mistake("z and thrust disagree: does z of the odometry point down?", {"force": _Z}, True),
    _Mistake("z disagrees with the velocity: does z point down?", {"position": _Z}),
    _Mistake("x and tilt disagree: is x of the odometry reversed?", {"force": _X}),
    _Mistake("y and tilt disagree: is y of the odometry reversed?", {"force": _Y}),
    _Mistake("x disagrees with the velocity: is it reversed?", {"position": _X}),
    _Mistake("y disagrees with the velocity: is it reversed?", {"position": _Y}),
    _Mistake("x, y and tilt disagree: are x and y swapped?", {"force": _SWAPPED}),
    _Mistake("x and y disagree with the velocity: are they swapped?", {"position": _SWAPPED}),
    *(
        _Mistake(
            f"heading and {what} disagree: is the heading off by {angle} degrees, or is "
            "odometry.twist_frame wrong?",
            {relation: turn},
        )
        for angle, turn in (("90", _LEFT), ("-90", _LEFT.T), ("180", _AROUND))
        for what, relation in (("velocity", "position"), ("acceleration", "force"))
    ),
    _Mistake(
        "attitude and body rates disagree: is the quaternion in the order w, x, y, z? expected "
        "x, y, z, w",
        {"attitude": _WXYZ, "position": _FLU_FRD, "force": _diagonal(1.0, 0.0, -1.0)},
    ),
    _Mistake(
        "attitude and body rates disagree: is the attitude inverted (world to body, conjugated)?",
        {"attitude": _BACK, "force": _AROUND},
    ),
    _Mistake(
        "body rates are too large for the attitude: are they in deg/s? expected rad/s",
        {"attitude": _DEGREES, "rates": _DEGREES},
    ),
    _Mistake(
        "body rates are zero while the attitude turns: does the source leave them empty?",
        {"attitude": _NOTHING, "rates": _NOTHING},
    ),
    _Mistake(
        "attitude and body rates disagree: is the sign of the rates reversed?",
        {"attitude": _BACK, "rates": _BACK},
    ),
    *(
        _Mistake(
            f"attitude and {name} rate disagree: is the sign of the {name} rate reversed?",
            {"attitude": flip, "rates": flip},
        )
        for name, flip in (("roll", _X), ("pitch", _Y), ("yaw", _Z))
    ),
    _Mistake(
        "velocity and position disagree: is the sign of the velocity reversed?",
        {"position": _BACK, "force": _BACK},
        z_is_mirrored=True,
    ),
    _Mistake(
        "the velocity is zero while the position changes: does the source leave it empty?",
        {"position": _NOTHING, "force": _NOTHING},
    ),
    _Mistake(
        "the velocity is too large for the position: is it in cm/s? expected m/s",
        {"position": _CENTI, "force": _CENTI},
    ),
    *(
        _Mistake(
            f"the position changes too fast for the velocity: is it in {unit}? expected m",
            {"position": share * _SAME},
        )
        for unit, share in (("cm", 0.01), ("mm", 0.001), ("feet", 0.3048))
    ),
    *(
        _Mistake(
            f"the vehicle turns against the commanded {name} rate: is its sign reversed on the "
            "way to the motors?",
            {"rates": flip},
        )
        for name, flip in (("roll", _X), ("pitch", _Y), ("yaw", _Z))
    ),
    _Mistake(
        "the vehicle answers commands of roll with pitch: are the axes swapped on the way to the "
        "motors, or is a rotor blocked?",
        {"rates": _SWAPPED},
    ),
    _Mistake(
        "the vehicle does not follow the commanded body rates: are the commands taken, is a rotor "
        "blocked, is the vehicle held?",
        {"rates": _NOTHING},
    ),
    _Mistake(
        "the vehicle does not follow the thrust: is a motor, a propeller or the battery missing, "
        "is the vehicle held?",
        {"force": _NOTHING},
    ),
)


def likely_cause(
    contradicted: Collection[str],
    sums: Mapping[str, tuple[Array, Array, Array]],
    lift: tuple[float, float],
) -> str:
    """Return the most likely cause in words, and what to check.

    Args:
        contradicted: Names of relations, of which the cause explains one at least.
        sums: S_xx, S_yx and S_yy of each relation, by its name.
        lift: Vertical force commanded and measured, as shares of the weight.
    """
    mistakes = [
        mistake for mistake in _MISTAKES if not mistake.gains.keys().isdisjoint(contradicted)
    ]
    return min(mistakes, key=lambda mistake: _misfit(mistake, sums, lift)).cause


def _misfit(
    mistake: _Mistake, sums: Mapping[str, tuple[Array, Array, Array]], lift: tuple[float, float]
) -> float:
    """Return the share of the measured motion that a mistake leaves unexplained."""
    misfit = _EACH_RELATION * len(mistake.gains)
    for name, each in sums.items():
        xx, yx, yy = Sums(*each)
        gain = mistake.gains.get(name, _SAME)
        left = np.trace(yy - 2.0 * gain @ yx.T + gain @ xx @ gain.T)
        # The larger of the two where the gain is a unit, so that both sides count.
        misfit += float(left / (np.trace(yy) + np.trace(gain @ xx @ gain.T) + _SMALLEST[name]))
    asked, measured = lift
    gain_z = float(mistake.gains.get("force", _SAME)[2, 2])
    expected = 2.0 - asked if mistake.z_is_mirrored else gain_z * asked
    return misfit + abs(measured - expected) / (abs(measured) + abs(expected) + _SMALL_LIFT)


_EACH_RELATION = 0.18
_SMALL_LIFT = 0.1  # of the weight
_SMALLEST = {"attitude": 0.01, "position": 0.02, "rates": 0.02, "force": 0.1}
