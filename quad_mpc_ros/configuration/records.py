# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Records: named numbers for Python and compiled code.

A class that derives from :class:`Record` declares fields. NumPy makes a structured type of them,
which Numba supports, so that packing, size and access follow from the declaration on both sides of
the compiled boundary::

    class Wheel(Record):
        radius: float  # m
        axle_W: Vector3  # unit vector

    wheel = Wheel.zeros()  # an array of no dimensions
    wheel[()].radius = 0.3  # its only element, in place
    wheels = Wheel.zeros(4)  # as many of them
    wheels["radius"]  # (4,), a view; wheels[2].axle_W is one as well

Compiled functions that Python calls take such arrays, whose dispatch costs 0.2 µs, and use
``wheel[()]``; compiled functions called from there take the record.
"""

from __future__ import annotations

from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Self,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R", bound="Record")

Vector3 = Annotated[NDArray[np.float64], (3,)]
"""Three numbers."""
Vector4 = Annotated[NDArray[np.float64], (4,)]
"""Four numbers."""
Matrix3 = Annotated[NDArray[np.float64], (3, 3)]
"""A 3 by 3 matrix."""


class Record:
    """Base of declarations; annotations are fields.

    A field is a ``float``, an ``int``, an array of floats (``Annotated[Array, shape]``, as
    :data:`Vector3`), or another record.
    """

    dtype: ClassVar[np.dtype[Any]]

    if TYPE_CHECKING:

        def copy(self) -> Self:
            """Return a copy in separate memory."""

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True)
        fields = [
            (name, *_format(hint)) for name, hint in hints.items() if get_origin(hint) != ClassVar
        ]
        cls.dtype = np.dtype((np.record, np.dtype(fields, align=True)))

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the fields."""
        return cls.dtype.names or ()

    @classmethod
    def zeros(cls, *shape: int) -> RecordArray[Self]:
        """Return an array of zeros; without a shape, a single record without dimensions."""
        zeros: Any = np.zeros(shape, cls.dtype)
        return zeros  # type: ignore[no-any-return]


def _format(hint: Any) -> tuple[Any, tuple[int, ...]]:
    """Return type and shape of a field."""
    if get_origin(hint) is Annotated:
        _array, shape = get_args(hint)
        return np.float64, shape
    if isinstance(hint, type) and issubclass(hint, Record):
        return hint.dtype, ()
    return {float: np.float64, int: np.int64}[hint], ()


if TYPE_CHECKING:

    class RecordArray(Generic[R]):
        """An array of records for type checkers; at run time a structured NumPy array."""

        shape: tuple[int, ...]

        def __len__(self) -> int: ...
        @overload
        def __getitem__(self, index: int | tuple[()]) -> R: ...
        @overload
        def __getitem__(self, index: slice) -> RecordArray[R]: ...
        @overload
        def __getitem__(self, index: str) -> Any: ...
        def __getitem__(self, index: Any) -> Any: ...
        def __setitem__(self, index: Any, value: Any) -> None: ...
        def copy(self) -> RecordArray[R]: ...
        def reshape(self, shape: tuple[int, ...]) -> RecordArray[R]: ...

else:

    class RecordArray(Generic[R]):
        """An array of records: a NumPy array of the structured type ``R.dtype``."""
