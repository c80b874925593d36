# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Draw the pictures of README: a lemniscate around pillars as an animation, nodes and topics.

python tools/update_readme_images.py
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch
from update_obstacle_images import draw_corridor

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.extras.guidance import guidance
from quad_mpc_ros.recordings.evaluation.simulated import load_config
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
PILLARS = ((1.6, 1.35, 0.2), (-1.6, -1.3, 0.25), (-2.75, 0.75, 0.15))  # x, y, radius [m]
HEIGHT, DURATION = 1.5, 12.6  # m, s
FREQUENCY = 1.0  # rad/s
EVERY = 4  # control steps for each picture
TRAIL = 120  # control steps
PLAN, CORRIDOR = "#CC79A7", "#009E73"


def main() -> None:
    """Write both pictures."""
    animate(flown(), IMAGES / "lemniscate_pillars.gif")
    draw_nodes(IMAGES / "nodes.svg")


def flown() -> list[LoopStep]:
    """Return the control steps of a flight that detects the pillars with a simulated lidar."""
    lines = [
        f"  - {{shape: cylinder, position: [{x}, {y}, {HEIGHT}], radius: {r}, height: 3.0}}"
        for x, y, r in PILLARS
    ]
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder, "pillars.yaml")
        scene.write_text("\n".join(["obstacles:", *lines, ""]))
        return list(steps_among(scene))


def steps_among(scene: Path) -> Iterator[LoopStep]:
    """Yield the control steps of a flight among the obstacles of a file."""
    config = load_config(
        "default",
        assignments=[
            "reference.trajectory=lemniscate",
            f"reference.angular_frequency={FREQUENCY}",
            f"reference.height={HEIGHT}",
            "mpc.obstacles.half_spaces=8",
            "mpc.lockstep=true",
            "simulator.obstacles.sensor=rays",
            f"simulator.obstacles.file={scene}",
            f"simulator.duration={DURATION}",
        ],
    )
    avoided = guidance(config.mpc)
    yield from fly(
        mpc=config.mpc,
        simulator=config.simulator,
        reference=config.reference,
        controller=warmed_up(config.mpc, guide=avoided.guide),
        world=avoided.world,
        on_reference=True,
    )


def animate(steps: list[LoopStep], path: Path) -> None:
    """Write the flight from above, with the plan and the corridor that holds it."""
    p_WB = np.array([step.truth.p_WB for step in steps])
    wanted = np.array([step.window.p_WB[0] for step in steps])
    figure = style.new_figure(7.6, 3.8, dpi=90)
    axes: Any = figure.subplots()

    def draw(number: int) -> None:
        axes.clear()
        style.tidy(axes)
        step = steps[number]
        for x, y, radius in PILLARS:
            axes.add_patch(Circle((x, y), radius, color=style.BOUND, alpha=0.7, linewidth=0))
        axes.scatter([], [], s=60, color=style.BOUND, alpha=0.7, label="pillar")
        axes.fill([], [], color=CORRIDOR, alpha=0.3, label="corridor")
        axes.plot(*wanted[:, :2].T, color=style.REFERENCE, linestyle="--", label="reference")
        trail = p_WB[max(number - TRAIL, 0) : number + 1]
        if step.tick is not None and step.tick.plan is not None:
            plan = step.tick.plan.p_WB
            guided = step.tick.guided
            if guided is not None and guided.corridor is not None:
                draw_corridor(axes, guided.corridor, plan)
            axes.plot(*plan[:, :2].T, color=PLAN, linewidth=2.5, label="plan of the MPC")
        axes.plot(*trail[:, :2].T, color=style.FLOWN, linewidth=2.0, label="flown")
        draw_vehicle(axes, step)
        axes.set_aspect("equal")
        axes.set(xlim=(-4.0, 4.0), ylim=(-2.0, 2.0))
        axes.set_xlabel("x, east [m]", fontsize=9, color=style.INK)
        axes.set_ylabel("y, north [m]", fontsize=9, color=style.INK)
        style.legend(axes)

    numbers = range(0, len(steps), EVERY)
    animation = FuncAnimation(figure, draw, frames=numbers, repeat=True)
    animation.save(path, writer=PillowWriter(fps=50 // EVERY))


def draw_vehicle(axes: Any, step: LoopStep) -> None:
    """Draw four rotors on a cross where the vehicle is."""
    x, y, z, w = step.odometry.q_WB_xyzw
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    place = step.truth.p_WB[:2]
    for k in range(4):
        angle = yaw + math.pi * (0.25 + 0.5 * k)
        tip = place + 0.17 * np.array([math.cos(angle), math.sin(angle)])
        axes.plot(*np.array([place, tip]).T, color=style.INK, linewidth=1.6, zorder=7)
        axes.add_patch(Circle(tuple(tip), 0.09, facecolor="#888888", alpha=0.6, zorder=7))


class Node(NamedTuple):
    """A box of the graph: its name, description and centre."""

    name: str
    what: str
    x: float
    y: float


NODES = (
    Node("reference_node", "trajectories, live requests", 0.0, 0.0),
    Node("mpc_node", "estimator, MPC, failsafe", 5.0, 0.0),
    Node("bridge or simulator_node", "PX4, ArduPilot, Crazyflie, ...", 10.0, 0.0),
    Node("your estimator", "or the bridge", 5.0, 2.2),
    Node("recorder_node", "rosbag2 bag, MCAP", 5.0, -2.2),
)
ARROWS = (
    ("reference_node", "mpc_node", "reference", "MultiDOFJointTrajectory"),
    ("mpc_node", "bridge or simulator_node", "command", "TwistStamped: throttle, rates"),
    ("your estimator", "mpc_node", "odom", "Odometry"),
    ("mpc_node", "recorder_node", "all topics", ""),
)
WIDE, HIGH = 3.0, 0.9


def draw_nodes(path: Path) -> None:
    """Write the graph of nodes with a topic and its message type on each arrow."""
    figure = style.new_figure(10.5, 4.2)
    axes: Any = figure.subplots()
    axes.set(xlim=(-1.7, 11.7), ylim=(-2.8, 2.8))
    axes.set_axis_off()
    places = {node.name: np.array([node.x, node.y]) for node in NODES}
    for node in NODES:
        corner = (node.x - 0.5 * WIDE, node.y - 0.5 * HIGH)
        box = FancyBboxPatch(
            corner,
            WIDE,
            HIGH,
            boxstyle="round,pad=0.02",
            facecolor="#EAF2F8",
            edgecolor=style.FLOWN,
        )
        axes.add_patch(box)
        write(axes, node.x, node.y + 0.17, node.name, weight="bold", size=10)
        write(axes, node.x, node.y - 0.2, node.what, size=8)
    for start, end, topic, kind in ARROWS:
        draw_arrow(axes, places[start], places[end], topic, kind)
    figure.savefig(path, format="svg", metadata={"Date": None})


def draw_arrow(axes: Any, start: Array, end: Array, topic: str, kind: str) -> None:
    """Draw an arrow between two boxes with the topic on it."""
    along = (end - start) / np.abs(end - start).max()
    edge = along * np.array([0.5 * WIDE + 0.08, 0.5 * HIGH + 0.08])
    arrow = FancyArrowPatch(
        tuple(start + edge),
        tuple(end - edge),
        arrowstyle="-|>",
        mutation_scale=14,
        color=style.INK,
    )
    axes.add_patch(arrow)
    middle = 0.5 * (start + end)
    if abs(along[0]) > abs(along[1]):
        write(axes, middle[0], middle[1] + 0.28, topic, weight="bold", size=9)
        write(axes, middle[0], middle[1] - 0.3, kind.replace(": ", ":\n"), size=7)
    else:
        axes.text(middle[0] + 0.15, middle[1], f"{topic}  {kind}", fontsize=9, color=style.INK)


def write(axes: Any, x: float, y: float, text: str, *, size: int, weight: str = "normal") -> None:
    """Write centred text."""
    axes.text(x, y, text, ha="center", va="center", fontsize=size, weight=weight, color=style.INK)


if __name__ == "__main__":
    main()
