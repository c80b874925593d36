# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of an identification: measured and fitted body rates and specific force."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.over_time import PanelColumn, write_panels
from quad_mpc_ros.analysis.figures.panels import Curve, Panel
from quad_mpc_ros.analysis.identification.result import (
    FittedCourse,
    Identification,
    ParameterEstimate,
)

_MAX_DURATION = 10.0  # s, of the part of a flight where the rates change most


def write_fit_figure(found: Identification, path: Path) -> Path:
    """Draw the ten seconds with the most motion. Raises ``OSError`` if writing fails."""
    start = _liveliest(found.rates)
    panels = [
        Panel(
            name="ω", subscript=name, unit="rad/s", curves=_curves(found.rates, axis, start=start)
        )
        for axis, name in enumerate("xyz")
    ]
    force = _curves(found.specific_force, 0, start=start)
    panels.append(Panel(name="specific force\nalong body z", unit="m/s²", curves=force))
    return write_panels([PanelColumn(title=_title(found), panels=panels)], path)


def _curves(course: FittedCourse, axis: int, *, start: float) -> list[Curve]:
    """Return one fitted and measured component over the drawn time."""
    shown = (course.time >= start) & (course.time <= start + _MAX_DURATION)
    time = course.time[shown]
    return [
        Curve(
            name="fitted",
            time=time,
            values=course.fitted[shown, axis],
            colour=style.REFERENCE,
            broad=True,
        ),
        Curve(name="measured", time=time, values=course.measured[shown, axis]),
    ]


def _title(found: Identification) -> str:
    names = {
        "rates lag": found.rate_time_constant,
        "thrust lags": (found.thrust_time_constant,),
        "delay": (found.input_delay,),
    }
    return ", ".join(f"{name} {_milliseconds(each)}" for name, each in names.items())


def _milliseconds(estimates: tuple[ParameterEstimate, ...]) -> str:
    texts = [f"{1e3 * each.value:.0f}" if each.observable else "?" for each in estimates]
    return f"{' / '.join(texts)} ms"


def _liveliest(rates: FittedCourse) -> float:
    """Return the start of the drawn time, in which the body rates vary most."""
    squares = np.sum((rates.measured - rates.measured.mean(axis=0)) ** 2, axis=1)
    sums = np.concatenate(([0.0], np.cumsum(squares)))
    ends = np.searchsorted(rates.time, rates.time + _MAX_DURATION)
    candidates = rates.time <= max(rates.time[-1] - _MAX_DURATION, rates.time[0])
    lively = np.where(candidates, sums[ends] - sums[:-1], -1.0)
    return float(rates.time[int(np.argmax(lively))])
