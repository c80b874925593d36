"""What an identification fits, drawn: measured and modelled body rates and specific force."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quad_mpc_ros.figures import style
from quad_mpc_ros.identification.result import FittedCourse, Identification

_LONGEST = 10.0  # s, of a flight, shown where the rates change most
_WIDTH, _HEIGHT = 8.0, 7.0  # inch


def write_fit_figure(found: Identification, path: Path) -> Path:
    """Draw the liveliest ten seconds into a PNG. Raises ``OSError`` if it cannot be written."""
    start = _liveliest(found.rates)
    figure = style.new_figure(_WIDTH, _HEIGHT)
    column = figure.subplots(4, 1, sharex=True)
    panels = [
        *((found.rates, axis, f"$\\omega_{name}$ [rad/s]") for axis, name in enumerate("xyz")),
        (found.specific_force, 0, "specific force\nalong body z [m/s²]"),
    ]
    for axes, (course, axis, label) in zip(column, panels, strict=True):
        shown = (course.time >= start) & (course.time <= start + _LONGEST)
        style.tidy(axes)
        for values, name, line in (
            (course.fitted, "fitted", style.REFERENCE_LINE),
            (course.measured, "measured", style.FLOWN_LINE),
        ):
            axes.plot(course.time[shown], values[shown, axis], label=name, **line)
        axes.set_ylabel(label, fontsize=9, color=style.INK)
    style.title(column[0], _title(found))
    style.legend(column[0])
    column[-1].set_xlabel("time [s]", fontsize=9, color=style.INK)
    figure.align_ylabels(column)
    return style.save(figure, path)


def _title(found: Identification) -> str:
    names = {
        "rates lag": found.rate_time_constant,
        "thrust lags": found.thrust_time_constant,
        "delay": found.input_delay,
    }
    parts = [
        f"{name} {1e3 * estimate.value:.0f} ms" if estimate.observable else f"{name} unknown"
        for name, estimate in names.items()
    ]
    return ", ".join(parts)


def _liveliest(rates: FittedCourse) -> float:
    """Return from when on the body rates vary most over the time that is shown."""
    squares = np.sum((rates.measured - rates.measured.mean(axis=0)) ** 2, axis=1)
    sums = np.concatenate(([0.0], np.cumsum(squares)))
    ends = np.searchsorted(rates.time, rates.time + _LONGEST)
    candidates = rates.time <= max(rates.time[-1] - _LONGEST, rates.time[0])
    lively = np.where(candidates, sums[ends] - sums[:-1], -1.0)
    return float(rates.time[int(np.argmax(lively))])
