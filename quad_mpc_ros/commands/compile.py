"""``quad_mpc compile``: makes all machine code now, so that no node has to when it starts."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

_PRESETS = ("default", "agile", "paper", "paper_rigid_body", "vehicles/racer", "vehicles/sun_2022")
_EFFECTS = (
    "simulator.rate_time_constant=0.03",
    "simulator.thrust_time_constant=0.03",
    "simulator.command_delay=0.02",
    "simulator.odom_delay=0.01",
    "simulator.odom_jitter=0.002",
    "simulator.wind=[1.0, 0.0, 0.0]",
    "simulator.gust_intensity=1.0",
    "simulator.position_noise=0.01",
    "simulator.attitude_noise=0.005",
    "simulator.velocity_noise=0.02",
    "simulator.rate_noise=0.01",
)
_IDEAL = ("mpc.rate_time_constant=0.0", "mpc.thrust_time_constant=0.0", "mpc.input_delay=0.0")
_NOT_ESTIMATING = ("mpc.estimate_disturbance=false",)
_DURATION = "simulator.duration=0.4"
_OF_FILES = ("csv", "bag")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command is."""
    parser.description = (
        "Compile whatever the controller, the simulator and the references call as machine code, "
        "and keep it on disk. It is for these sources, this Python, these libraries and this "
        "processor; when one of them changes, run it again. A node that finds code missing "
        "compiles it itself, and says so."
    )


def run(options: argparse.Namespace) -> int:
    """Fly a little of everything; return the exit code."""
    from quad_mpc_ros.configuration import compilation

    if compilation.is_complete():
        print("all is compiled")
        return 0
    begun = time.monotonic()
    print("compiling; the first time takes a minute or two", flush=True)
    for what in _flown():
        made = len(compilation.left_to_numba())
        print(f"  {what}: {made} functions compiled so far", flush=True)
    compilation.note_complete()
    made, taken = len(compilation.left_to_numba()), time.monotonic() - begun
    print(f"all is compiled: {made} functions now, in {taken:.0f} s")
    return 0


def _flown() -> Iterator[str]:
    """Fly what there is to fly, piece by piece, and yield what it was."""
    from quad_mpc_ros.references.config import TRAJECTORIES

    yield from _presets()
    yield from _plants()
    for name in TRAJECTORIES:
        if name not in _OF_FILES:
            _follow(name)
            yield f"reference {name}"


def _presets() -> Iterator[str]:
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.closed_loop import fly

    for preset in _PRESETS:
        for more in (), _IDEAL, _NOT_ESTIMATING:
            mpc, simulator, reference = load_config(
                preset, assignments=(_DURATION, *more, "mpc.lockstep=true")
            )
            for _ in fly(mpc=mpc, simulator=simulator, reference=reference):
                pass
        yield f"preset {preset}"


def _plants() -> Iterator[str]:
    from quad_mpc_ros.configuration import UserError
    from quad_mpc_ros.control.warm_up import warmed_up
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.config import PLANTS
    from quad_mpc_ros.simulation.warm_up import warm_up

    for (name, entry), effects in itertools.product(PLANTS.items(), ((), _EFFECTS)):
        own = tuple(f"simulator.{parameter}=" for parameter in entry.has_own)
        assignments = (effect for effect in effects if not own or not effect.startswith(own))
        try:
            config = load_config(
                entry.preset or "default",
                assignments=(f"simulator.plant={name}", _DURATION, *assignments),
            )
            warm_up(config.simulator)
            warmed_up(config.mpc)
        except (ImportError, UserError):  # it is not installed
            continue
        yield f"plant {name}"


def _follow(name: str) -> None:
    """Fly a trajectory, and to it, as the reference node does."""
    import functools

    import numpy as np

    from quad_mpc_ros.control.model.samples import OdometrySample
    from quad_mpc_ros.references.config import ReferenceConfig
    from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
    from quad_mpc_ros.references.live import LiveReference

    high, level = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0])
    for mode in ("at_once", "on_request"):
        config = ReferenceConfig(trajectory=name, mode=mode)
        joined = functools.partial(joined_trajectory, config)
        live = LiveReference(config, configured_trajectory(config), joined=joined)
        live.observe(OdometrySample.at_rest([0.0, 0.0, 0.0]))
        live.engage(True)
        for now_ns, request in (
            (100_000_000, live.take_off),
            (10_000_000_000, live.start),
            (25_000_000_000, live.hold),
            (40_000_000_000, live.land),
        ):
            live.window(now_ns)
            request(now_ns)
        live.go_to(50_000_000_000, frame_id="odom", p_WB=high, q_WB_xyzw=level)
        live.window(51_000_000_000)
        live.course(51_000_000_000)
