"""What is drawn over time: a row of curves that share an axis of values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from quad_mpc_ros.figures import style
from quad_mpc_ros.figures.panels import Panel
from quad_mpc_ros.lie import Array

_SYMBOLS = {"\\omega": "ω"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Values over time [s], both (n,); ``held`` tells that one holds until the next.

    ``hover`` (n,) is shown beside a value.
    """

    name: str
    time: Array
    values: NDArray[Any]
    colour: str
    width: float = 1.5
    held: bool = False
    hover: NDArray[Any] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """Curves on one axis, with bounds drawn across; ``label`` may hold Plotly's HTML.

    ``names`` are those of the values 0, 1, … when these stand for something.
    """

    label: str
    curves: Sequence[Curve]
    bounds: Sequence[float] = ()
    logarithmic: bool = False
    names: Sequence[str] = ()


def row_of(panel: Panel) -> Row:
    """Return a panel of the figures as a row of the page."""
    flown = Curve(
        name="commanded" if panel.held else "flown",
        time=panel.time,
        values=panel.flown,
        colour=style.FLOWN,
        held=panel.held,
    )
    curves = [flown]
    if panel.reference is not None:
        # First, hence below: it is broader, and seen where the flight lies on it.
        reference = Curve(
            name="reference",
            time=panel.reference_time,
            values=panel.reference,
            colour=style.REFERENCE,
            width=3.0,
            held=True,
        )
        curves.insert(0, reference)
    return Row(label=_html(panel.label), curves=curves, bounds=panel.bounds or ())


def _html(label: str) -> str:
    """Return a label for matplotlib, with symbols like ``$q_w$``, as Plotly writes it."""
    return re.sub(
        r"\$(\\?\w+?)_(\w)\$",
        lambda found: f"{_SYMBOLS.get(found[1], found[1])}<sub>{found[2]}</sub>",
        label,
    )
