# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of the page on obstacles: a flight around obstacles, and the detected points.

python tools/update_obstacle_images.py
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.path_figure import write_path
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.guidance import guidance
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld
from quad_mpc_ros.recordings.evaluation.simulated import FlightLog, load_config
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

ROOT = Path(__file__).resolve().parents[1]
PAGE, IMAGES = ROOT / "docs/howto/obstacles.md", ROOT / "docs" / "images"
SETTINGS = [
    "reference.trajectory=minimum_snap",
    "reference.waypoints=[0.0, 0.0, 1.5, 4.5, 0.0, 1.5, 9.0, 0.0, 1.5]",
    "reference.max_speed=2.5",
    "mpc.obstacles.half_spaces=8",
    "mpc.lockstep=true",
    "simulator.obstacles.sensor=rays",
    "simulator.duration=9.0",
]
SHOWN_AT = 3.2  # s


def main() -> None:
    """Fly the page's file, draw the flight, and from above the detected points at one time."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch, "pillars.yaml")
        block = re.search(r"```yaml pillars\.yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)
        assert block is not None
        file.write_text(block[1])
        draw([*SETTINGS, f"simulator.obstacles.file={file}"])


def draw(settings: list[str]) -> None:
    """Fly with some settings and write both pictures."""
    config = load_config("default", assignments=settings)
    avoided = guidance(config.mpc)
    assert avoided.world is not None
    controller = warmed_up(config.mpc, guide=avoided.guide)
    log, drawn = FlightLog(config.mpc), False
    for step in fly(
        mpc=config.mpc,
        simulator=config.simulator,
        reference=config.reference,
        controller=controller,
        world=avoided.world,
        on_reference=True,
    ):
        log.take(step)
        flight = log.flight(config)
        if not drawn and flight.time[-1] >= SHOWN_AT:
            drawn = True
            view_from_above(step, avoided.world, flight.p_WB, IMAGES / "obstacles_above.png")
    write_path(flight, IMAGES / "obstacles_path.png")


def view_from_above(step: LoopStep, world: ObstacleWorld, flown: Array, path: Path) -> None:
    """Draw detected points, plan and corridor at the height of the flight."""
    assert step.tick is not None and step.tick.plan is not None and step.tick.guided is not None
    figure = style.new_figure(8.0, 3.6)
    axes: Axes = figure.subplots()
    style.tidy(axes)
    place, stamp_ns = step.odometry.p_WB, step.odometry.stamp_ns
    guided, plan = step.tick.guided, step.tick.plan
    if guided.corridor is not None:
        draw_corridor(axes, guided.corridor, plan.p_WB)
    points = world.points(stamp_ns, near=place, radius=8.0)
    level = points[np.abs(points[:, 2] - place[2]) < 0.6]
    axes.scatter(*level[:, :2].T, s=4, color=style.BOUND, label="detected points", zorder=4)
    axes.plot([0.0, 9.0], [0.0, 0.0], color=style.REFERENCE, linestyle="--", label="reference")
    axes.plot(*flown[:, :2].T, color=style.FLOWN, linewidth=2.0, label="flown", zorder=5)
    axes.plot(*plan.p_WB[:, :2].T, color="#CC79A7", linewidth=2.0, label="plan", zorder=6)
    axes.plot(*guided.window.p_WB[:, :2].T, color=style.INK, linewidth=1.0, label="guide")
    axes.set_aspect("equal")
    axes.set(xlim=(-0.5, 9.5), ylim=(-2.0, 2.0))
    axes.set_xlabel("x, east [m]", fontsize=9, color=style.INK)
    axes.set_ylabel("y, north [m]", fontsize=9, color=style.INK)
    style.title(axes, f"From above, after {SHOWN_AT:g} s")
    style.legend(axes)
    style.save(figure, path)


def draw_corridor(axes: Axes, corridor: Corridor, plan: Array) -> None:
    """Draw the free regions of some stages at the height of the plan there."""
    count = len(corridor.offsets)
    for stage in (count // 3, 2 * count // 3, count - 1):
        place = plan[stage + 1]
        ring = cut(corridor.normals[stage], corridor.offsets[stage], place)
        axes.fill(*ring.T, color="#009E73", alpha=0.12, linewidth=0)
        axes.plot(*np.vstack((ring, ring[:1])).T, color="#009E73", linewidth=0.8)


def cut(normals: Array, offsets: Array, place: Array, reach: float = 1.2) -> Array:
    """Return the region of half-spaces as a polygon (n, 2) at the height of a position."""
    ring = place[:2] + reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    for normal, offset in zip(normals, offsets, strict=True):
        if not np.isfinite(offset):
            continue
        room = offset - normal[2] * place[2] - ring @ normal[:2]
        kept = []
        for k in range(len(ring)):
            here, there = room[k], room[(k + 1) % len(ring)]
            if here >= 0.0:
                kept.append(ring[k])
            if here * there < 0.0:
                share = here / (here - there)
                kept.append(ring[k] + share * (ring[(k + 1) % len(ring)] - ring[k]))
        ring = np.array(kept).reshape(-1, 2)
    return ring


if __name__ == "__main__":
    main()
