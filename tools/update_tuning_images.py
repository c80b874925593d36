# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly the flights of docs/howto/tune.md, print the numbers, and draw the figures.

python tools/update_tuning_images.py
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.commands.run_configuration import run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
# Okabe and Ito's, from the default's neighbours on both sides.
COLOURS = ("#56B4E9", "#0072B2", "#009E73", "#E69F00", "#D55E00")

FAST = ("--reference", "lemniscate", "--set", "reference.angular_frequency=2.6")
LAGS = (
    "simulator.rate_time_constant=0.03",
    "simulator.thrust_time_constant=0.03",
    "simulator.command_delay=0.02",
)
NOISE = (
    "simulator.position_noise=0.01",
    "simulator.attitude_noise=0.00873",
    "simulator.velocity_noise=0.05",
)
# The weights that the page speaks of, and a vehicle that answers at once, which shows them best.
AGILE = (
    "--config",
    "agile",
    *(
        part
        for name in ("rate_time_constant", "thrust_time_constant")
        for part in ("--set", f"mpc.{name}=0", "--set", f"simulator.{name}=0")
    ),
    *("--set", "mpc.input_delay=0", "--set", "simulator.command_delay=0"),
)
ON, OFF = "mpc.estimate_disturbance=true", "mpc.estimate_disturbance=false"


@dataclass(frozen=True, kw_only=True, eq=False)
class Flown:
    """A flight of ten seconds: ``time`` (n,) [s], true ``p_WB`` (n, 3), ``distance`` (n,) [m]."""

    time: Array
    p_WB: Array
    distance: Array

    @property
    def rmse(self) -> float:
        """Root mean square of the distance to the reference [m]."""
        return float(np.sqrt(np.mean(self.distance**2)))

    @property
    def before_switch(self) -> float:
        """Distance just before the square's corners change, every 2 s, the median [m]."""
        return float(np.median(self.distance[99::100]))

    @property
    def overshoot(self) -> float:
        """Overshoot at the second corner, 2 m east [m]."""
        there = (self.time >= 2.0) & (self.time < 4.0)
        return float(self.p_WB[there, 0].max()) - 2.0

    def within(self, distance: float) -> float:
        """Return the settling time to a distance after the second corner [s]."""
        there = (self.time >= 2.0) & (self.time < 4.0)
        return 0.02 * float(np.flatnonzero(self.distance[there] > distance)[-1] + 1)


def flown(*assignments: str, options: Sequence[str] = ()) -> Flown:
    """Fly like ``quad_mpc simulate``, and print the errors."""
    parser = argparse.ArgumentParser()
    add_run_options(parser)
    arguments = [*AGILE, *options, *(part for text in assignments for part in ("--set", text))]
    with tempfile.TemporaryDirectory() as scratch:
        run = run_configuration(parser.parse_args([*arguments, "--out", scratch]), lockstep=True)
    truth = [
        step.truth
        for step in fly(
            mpc=run.mpc,
            simulator=run.simulator,
            reference=run.reference,
            trajectory=run.trajectory,
        )
    ]
    times_ns = [odometry.stamp_ns - SIMULATION_START_NS for odometry in truth]
    p_WB = np.array([odometry.p_WB for odometry in truth])
    distance = np.linalg.norm(run.trajectory.at(times_ns).p_WB - p_WB, axis=1)
    flight = Flown(time=1e-9 * np.array(times_ns), p_WB=p_WB, distance=distance)
    print(
        f"rmse {flight.rmse:.4f}  last 4 s {flight.distance[-200:].mean():.5f}  "
        f"before switch {flight.before_switch:.5f}  {' '.join(arguments)}",
        flush=True,
    )
    return flight


def update_horizon() -> None:
    """Draw the square against the length of the horizon."""
    steps = (4, 5, 6, 8, 10, 15, 20)
    figure, (before, overall) = _two_axes()
    for colour, weight in zip(COLOURS, (1, 10, 30, 100), strict=False):
        flights = [flown(f"mpc.horizon_steps={n}", f"mpc.terminal_weight={weight}") for n in steps]
        line = _marked(colour, f"{weight}")
        before.semilogy(steps, [flight.before_switch for flight in flights], **line)
        overall.plot(steps, [flight.rmse for flight in flights], **line)
    _label(before, "error before the switch [m]", "horizon_steps of 0.05 s")
    _label(overall, "RMSE [m]", "horizon_steps of 0.05 s")
    _finish(figure, "tuning_horizon.png", "terminal_weight", overall)


def update_steps() -> None:
    """Draw the motion east to the second corner for several weights."""
    figure, axes = _two_axes()
    velocity = {
        f"{q:g}": f"mpc.Q=[10,10,10,{q},{q},{q},0.01,0.01,0.01]"
        for q in (0.1, 0.3, 1.0, 3.0, 10.0)
    }
    rates = {f"{r:g}": f"mpc.R=[0,{r},{r},{r}]" for r in (0.0001, 0.001, 0.01, 0.1, 1.0)}
    for subplot, name, cases in (
        (axes[0], "Q, velocity", velocity),
        (axes[1], "R, body rates", rates),
    ):
        for colour, (label, assignment) in zip(COLOURS, cases.items(), strict=True):
            flight = flown(assignment)
            print(
                f"  within 5 cm after {flight.within(0.05):.2f} s, "
                f"overshoots by {flight.overshoot:.3f} m"
            )
            there = (flight.time >= 2.0) & (flight.time < 4.0)
            subplot.plot(
                flight.time[there] - 2.0, flight.p_WB[there, 0], color=colour, label=label
            )
        _label(subplot, "x [m]", "time after the step [s]")
        _legend(subplot, name)
    _finish(figure, "tuning_weights.png")


def update_model() -> None:
    """Draw the fast lemniscate for several modelled lags and delays."""
    figure, (lag, delay) = _two_axes()
    for colour, assignment, label in ((COLOURS[1], ON, "on"), (COLOURS[4], OFF, "off")):
        line = _marked(colour, label)
        lags, delays = (0, 10, 20, 30, 40, 50, 60), (0, 5, 10, 15, 20, 25, 30, 35, 40)
        by_lag = [_modelled(assignment, lag_ms=ms, delay_ms=20).rmse for ms in lags]
        by_delay = [_modelled(assignment, lag_ms=30, delay_ms=ms).rmse for ms in delays]
        lag.semilogy(lags, by_lag, **line)
        delay.semilogy(delays, by_delay, **line)
    _label(lag, "RMSE [m]", "modelled lags [ms], true: 30 ms")
    _label(delay, "RMSE [m]", "modelled delay [ms], true: 20 ms")
    _finish(figure, "tuning_model.png", "estimate_disturbance", delay)


def print_others() -> None:
    """Fly the flights of the page that have no picture."""
    flown(*LAGS, options=FAST)
    for steps, step in ((25, 0.02), (20, 0.025), (10, 0.05), (5, 0.1)):
        flown(f"mpc.horizon_steps={steps}", f"mpc.horizon_step={step}")
    for q in (0.001, 0.01, 1.0, 10.0):
        print(f"  overshoots by {flown(f'mpc.Q=[10,10,10,1,1,1,{q},{q},{q}]').overshoot:.3f} m")
    slow = ("--reference", "lemniscate")
    for r in (0.001, 0.01, 0.1):
        flown(*NOISE, f"mpc.R=[0,{r},{r},{r}]", options=slow)
    for assignment in (ON, OFF):
        flown(NOISE[-1], assignment, options=slow)
    flown("simulator.velocity_bias=[0.1,0.0,0.0]", options=slow)
    flown("simulator.position_bias=[0.1,0.0,0.0]", options=slow)


def _modelled(assignment: str, *, lag_ms: int, delay_ms: int) -> Flown:
    modelled = [
        f"mpc.rate_time_constant={1e-3 * lag_ms:.3f}",
        f"mpc.thrust_time_constant={1e-3 * lag_ms:.3f}",
        f"mpc.input_delay={1e-3 * delay_ms:.3f}",
    ]
    return flown(assignment, *LAGS, *modelled, options=FAST)


def update_disturbance() -> None:
    """Draw the error over time in wind and with a vehicle that is too heavy."""
    figure, axes = _two_axes()
    disturbances = {
        "wind of 5 m/s": "simulator.wind=[5.0,0.0,0.0]",
        "20 % heavier": "simulator.mass_scale=1.2",
    }
    for subplot, (what, disturbance) in zip(axes, disturbances.items(), strict=True):
        for colour, assignment, label in ((COLOURS[1], ON, "on"), (COLOURS[4], OFF, "off")):
            flight = flown(disturbance, assignment, options=("--reference", "lemniscate"))
            subplot.semilogy(flight.time[1:], flight.distance[1:], color=colour, label=label)
        subplot.set_ylim(1e-5, 0.1)
        _label(subplot, "position error [m]", "time [s]")
        style.title(subplot, what)
    _finish(figure, "tuning_disturbance.png", "estimate_disturbance", axes[1])


def _marked(colour: str, label: str) -> dict[str, Any]:
    return {"color": colour, "marker": "o", "markersize": 3, "label": label}


def _two_axes() -> tuple[Figure, tuple[Axes, Axes]]:
    figure = style.new_figure(9.0, 3.0, dpi=130)
    left, right = figure.subplots(1, 2)
    return figure, (left, right)


def _label(axes: Axes, y: str, x: str) -> None:
    axes.set_xlabel(x, fontsize=9, color=style.INK)
    axes.set_ylabel(y, fontsize=9, color=style.INK)
    style.tidy(axes)
    axes.tick_params(which="minor", color=style.FAINT, labelcolor=style.INK, labelsize=8)


def _legend(axes: Axes, title: str) -> None:
    axes.legend(title=title, frameon=False, fontsize=8, title_fontsize=8, labelcolor=style.INK)


def _finish(figure: Figure, name: str, legend: str = "", axes: Axes | None = None) -> None:
    if axes is not None:
        _legend(axes, legend)
    style.save(figure, IMAGES / name)


if __name__ == "__main__":
    update_horizon()
    update_steps()
    update_model()
    update_disturbance()
    print_others()
