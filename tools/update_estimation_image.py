# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly an unidentified vehicle, and draw the estimates over the true values.

python tools/update_estimation_image.py
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quad_mpc_ros import load_config
from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.closed_loop import fly

if TYPE_CHECKING:
    from quad_mpc_ros.control.tick import TickStats

IMAGE = Path(__file__).resolve().parents[1] / "docs" / "images" / "estimation.png"
SCALE, DRAG, WIND, RATE_LAG, THRUST_LAG = 0.8, 0.45, 3.0, 0.05, 0.06
FLIGHT = (
    f"simulator.thrust_scale={SCALE}",
    f"simulator.drag={DRAG}",
    f"simulator.wind=[{WIND},0.0,0.0]",
    f"simulator.rate_time_constant={RATE_LAG}",
    f"simulator.thrust_time_constant={THRUST_LAG}",
    "simulator.position_noise=0.003",
    "simulator.attitude_noise=0.003",
    "simulator.velocity_noise=0.02",
    "simulator.rate_noise=0.02",
    "simulator.velocity_drift=0.3",
    "simulator.duration=20.0",
    "simulator.initial_position=[0.0,0.0,2.0]",
    "reference.trajectory=lemniscate",
    "reference.angular_frequency=1.2",
)


def main() -> None:
    """Fly, and write the picture."""
    config = load_config(assignments=FLIGHT)
    times, stats, errors = [], [], []
    for step in fly(mpc=config.mpc, simulator=config.simulator, reference=config.reference):
        if step.tick is not None:
            times.append(1e-9 * step.truth.stamp_ns)
            stats.append(step.tick.stats)
            errors.append(float(np.linalg.norm(step.truth.p_WB - step.window.p_WB[0])))
    _draw(np.array(times) - times[0], stats, 100.0 * np.array(errors))


def _draw(time: Array, stats: list[TickStats], error: Array) -> None:
    panels = (
        ("thrust scale", [("thrust_scale", SCALE)]),
        ("disturbance [m/s²]", [("disturbance_x", DRAG * WIND), ("disturbance_z", 0.0)]),
        ("drag [1/s]", [("drag", DRAG)]),
        (
            "lags [ms]",
            [
                ("rate_time_constant_ms", 1e3 * RATE_LAG),
                ("thrust_time_constant_ms", 1e3 * THRUST_LAG),
            ],
        ),
    )
    figure = style.new_figure(8.0, 8.0)
    axes = figure.subplots(len(panels) + 1, 1, sharex=True)
    for axis, (label, curves) in zip(axes[:-1], panels, strict=True):
        for colour, (name, truth) in zip(("#0072B2", "#E69F00"), curves, strict=False):
            values = [getattr(each, name) for each in stats]
            axis.plot(time, values, color=colour, label=name.replace("_", " ").removesuffix(" ms"))
            axis.axhline(truth, color=colour, linestyle=":")
        axis.set_ylabel(label)
        style.legend(axis)
        style.tidy(axis)
    axes[-1].plot(time, error, color="black")
    axes[-1].set_ylabel("error [cm]")
    axes[-1].set_ylim(0.0, 30.0)
    axes[-1].set_xlabel("time [s]")
    style.tidy(axes[-1])
    style.save(figure, IMAGE)


if __name__ == "__main__":
    main()
