"""Fly by a scripted joystick, watch a flight, and write the pictures of docs/teleop and watch.

python tools/update_live_images.py
"""

from __future__ import annotations

import functools
import io
import re
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.patches import Rectangle
from rich.console import Console

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.watch import recorded
from quad_mpc_ros.commands.watch.screen import Screen
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import joined_trajectory
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.velocity import VelocityCommand
from quad_mpc_ros.ros.teleop.config import TeleopConfig
from quad_mpc_ros.ros.teleop.joystick import Joystick
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS
from quad_mpc_ros.simulation.sensors import OdometryStream

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
TELEOP = TeleopConfig(speed=1.5)
WALLS = ((-1.0, -2.0, 0.0), (4.0, 2.0, 3.0))
BEGIN, END = 6.0, 22.0  # s, of what is drawn
# From when on [s]: the forward and the left stick, the yaw, and whether the deadman is held.
STICKS = (
    (0.0, 0.0, 0.0, 0.0, False),
    (7.0, 0.7, 0.0, 0.0, True),
    (9.0, 0.7, 0.0, 0.0, False),  # let go, still pushed
    (11.0, 1.0, 0.4, 0.0, True),  # into the wall
    (15.0, 0.0, 0.0, 0.0, True),
    (16.0, 0.6, 0.0, 1.0, True),
    (20.0, 0.0, 0.0, 0.0, False),
)
_FAR = 0.8  # of the walls, in the picture from above


def fly_by_hand() -> dict[str, np.ndarray]:
    """Return time, position and velocity (n, 3) commanded, of the reference and flown."""
    config = ReferenceConfig.build(
        {"mode": "on_request", "fence.minimum": WALLS[0], "fence.maximum": WALLS[1]}
    )
    joined = functools.cache(lambda: joined_trajectory(config))
    live, joystick = LiveReference(config, joined(), joined=joined), Joystick(TELEOP.joystick)
    simulator = SimulatorConfig(duration=END, odom_rate=50.0)
    plant, controller = make_plant(simulator), warmed_up(MpcConfig())
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    rows: dict[str, list[np.ndarray]] = {}
    while (sent := stream.step()) is not None:
        now_ns = SIMULATION_START_NS + sent.time_ns
        live.observe(sent.truth)
        if sent.time_ns == 0:
            live.take_off(now_ns)
        asked = _asked(joystick, 1e-9 * sent.time_ns)
        live.move(now_ns, asked)
        window = live.window(now_ns)
        assert window is not None
        controller.receive_reference(window, now_ns=now_ns)
        tick = controller.receive_odometry(sent.truth, now_ns=now_ns)
        if tick is not None and tick.command is not None:
            plant.apply(tick.command)
        R_WB = so3.rotation_from_quaternion_xyzw(sent.truth.q_WB_xyzw)
        R_ref = so3.rotation_from_quaternion_xyzw(window.q_WB_xyzw[0])
        for name, value in {
            "time": np.array(1e-9 * sent.time_ns),
            "asked": asked.velocity,
            "v_reference": R_ref.T @ window.v_WB_W[0],
            "v": sent.truth.v_WB_B,
            "p_reference": window.p_WB[0],
            "p": sent.truth.p_WB,
            "nose": R_WB[:, 0],
        }.items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


def _asked(joystick: Joystick, seconds: float) -> VelocityCommand:
    """Return what the sticks ask for at a time, as the teleop node sends it."""
    _, forward, left, yaw, held = [stick for stick in STICKS if stick[0] <= seconds][-1]
    config = TELEOP.joystick
    axes, buttons = [0.0] * 6, [0] * 15
    axes[config.forward_axis], axes[config.left_axis] = forward, left
    axes[config.yaw_axis], buttons[config.deadman_button] = yaw, int(held)
    joystick.receive(axes, buttons, now=seconds)
    motion = joystick.motion(now=seconds)
    velocity = TELEOP.speed * np.array([motion.forward, motion.left, 0.0])
    yaw_rate = TELEOP.yaw_rate * motion.yaw
    return VelocityCommand(velocity=velocity, yaw_rate=yaw_rate, heading_aligned=True)


def draw(flown: dict[str, np.ndarray]) -> None:
    """Draw the velocities over time, and the way from above."""
    figure = style.new_figure(9.0, 4.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0))
    shown = flown["time"] >= BEGIN
    for row, name in enumerate(("forward", "left")):
        axes = figure.add_subplot(grid[row, 0])
        time = flown["time"][shown]
        axes.step(
            time, flown["asked"][shown, row], where="post", color=style.INK, lw=1.0, label="stick"
        )
        for key, colour, label, width in (
            ("v_reference", style.REFERENCE, "reference", 3.5),
            ("v", style.FLOWN, "vehicle", 1.4),
        ):
            axes.plot(time, flown[key][shown, row], color=colour, lw=width, label=label)
        axes.set_ylabel("m/s", fontsize=8, color=style.INK)
        style.tidy(axes)
        style.title(axes, name)
        if row == 0:
            style.legend(axes)
    axes.set_xlabel("s", fontsize=8, color=style.INK)
    above = figure.add_subplot(grid[:, 1])
    (left, back, _), (right, front, _) = WALLS
    walls = Rectangle(
        (left, back), right - left, front - back, fill=False, edgecolor=style.BOUND, lw=1.4
    )
    above.add_patch(walls)
    for key, colour, width in (("p_reference", style.REFERENCE, 3.5), ("p", style.FLOWN, 1.4)):
        above.plot(*flown[key][shown, :2].T, color=colour, lw=width)
    each = np.flatnonzero(shown)[::50]
    above.quiver(
        *flown["p"][each, :2].T, *flown["nose"][each, :2].T, color=style.FLOWN, width=0.006,
        scale=14.0,
    )  # fmt: skip
    above.set_aspect("equal")
    above.set_xlim(left - _FAR, right + _FAR)
    above.set_ylim(back - _FAR, front + _FAR)
    above.set_xlabel("x [m]", fontsize=8, color=style.INK)
    above.set_ylabel("y [m]", fontsize=8, color=style.INK)
    style.tidy(above)
    style.title(above, "from above, and the fence")
    figure.savefig(IMAGES / "teleop.png", dpi=110)


def draw_panel() -> None:
    """Fly with wind and a heavier vehicle, and draw what ``quad_mpc watch`` shows of the end."""
    flight = (
        "reference.trajectory=lemniscate",
        "simulator.mass_scale=1.1",
        "simulator.wind=[2.0,0.0,0.0]",
        "simulator.rate_time_constant=0.04",
    )
    with tempfile.TemporaryDirectory() as scratch:
        given = [part for each in flight for part in ("--set", each)]
        main(["fly", "--lockstep", "--duration", "20", "--out", scratch, *given])
        bag = Path(scratch, "bag")
        console = Console(record=True, width=120, file=io.StringIO(), force_terminal=True)
        screen = Screen(once=True, console=console)
        recorded.watch_bag(bag, screen, namespaces=None, rate=1.0, interval=0.25)
    picture = console.export_svg(title="quad_mpc watch", clear=True).replace(f"{scratch}/", "")
    # A page fetches nothing from elsewhere: a fixed font of the reader's does.
    picture = re.sub(r"@font-face\s*{[^}]*}", "", picture)
    (IMAGES / "watch.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    draw(fly_by_hand())
    draw_panel()
