# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Records: declared once, the same numbers by name in Python and in compiled code."""

from __future__ import annotations

from typing import Annotated

import numba
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array


class Wheel(Record):
    """A wheel."""

    radius: float
    axle: Vector3


class Cart(Record):
    """A cart, with a record inside."""

    wheels: int
    front: Wheel
    frame: Matrix3
    track: Annotated[Array, (2, 4)]


class NamedCart(Cart):
    """A cart with one field more."""

    price: float


@compiled
def turn(carts: RecordArray[Cart], angle: float) -> float:
    """Write into fields of each cart; return the sum of the radii."""
    total = 0.0
    for k in range(len(carts)):
        cart = carts[k]
        total += cart.front.radius
        cart.wheels += k
        cart.front.axle[2] = angle
        cart.frame[1, 2] = cart.track[1, 3]
    return total


@compiled
def misspelt(cart: Cart) -> float:
    """Read a field that does not exist."""
    return cart.front.radios  # type: ignore[attr-defined,no-any-return]


def test_layout_follows_from_declaration() -> None:
    assert Cart.names() == ("wheels", "front", "frame", "track")
    assert Cart.dtype["wheels"] == np.int64
    assert Cart.dtype["front"] == Wheel.dtype
    assert Cart.dtype["frame"].shape == (3, 3)
    assert Cart.dtype["track"].shape == (2, 4)
    assert Cart.dtype.itemsize == 8 * (1 + 4 + 9 + 8)


def test_derived_record_has_inherited_fields_first() -> None:
    assert NamedCart.names() == (*Cart.names(), "price")


def test_compiled_code_reads_and_writes_by_name() -> None:
    carts = Cart.zeros(3)
    carts["front"]["radius"] = 0.1, 0.2, 0.4
    carts["track"][:, 1, 3] = 7.0, 8.0, 9.0
    assert turn(carts, 0.5) == pytest.approx(0.7)
    assert_array_equal(carts["wheels"], [0, 1, 2])
    assert_array_equal(carts["front"]["axle"], np.tile([0.0, 0.0, 0.5], (3, 1)))
    assert_array_equal(carts["frame"][:, 1, 2], [7.0, 8.0, 9.0])
    assert np.count_nonzero(carts["frame"]) == 3


def test_wrong_field_name_fails_in_python() -> None:
    carts = Cart.zeros(2)
    with pytest.raises(AttributeError, match="radios"):
        carts[0].front.radios = 0.3  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="radios"):
        _ = carts[0].front.radios  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="radios"):
        _ = carts["radios"]


def test_wrong_field_name_fails_to_compile() -> None:
    with pytest.raises((KeyError, numba.TypingError), match="radios"):
        misspelt(Cart.zeros()[()])


def test_field_of_an_unknown_type_is_not_declared() -> None:
    with pytest.raises(KeyError):
        type("Named", (Record,), {"__annotations__": {"name": str}, "__module__": __name__})
