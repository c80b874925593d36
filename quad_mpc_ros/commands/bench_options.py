"""Options of ``quad_mpc bench``, and what they ask for."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from quad_mpc_ros.bench.config import BenchConfig
from quad_mpc_ros.bench.peers import PEERS, SWEPT
from quad_mpc_ros.commands.run_options import SCHEMA
from quad_mpc_ros.configuration import ConfigurationError, UserError, files
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.trajectories.config import ReferenceConfig

RESULT, PAGE, PICTURE = "performance.json", "performance.md", "performance.png"
_STEPS = (5, 10, 20, 40)


def add_bench_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``quad_mpc bench``."""
    parser.add_argument(
        "--peers",
        nargs="+",
        default=list(PEERS),
        metavar="NAME",
        help=f"what to compare: {', '.join(PEERS)} (default: all; what is not installed is "
        "skipped with a note)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=10.0,
        metavar="S",
        help="length of each flight in seconds of simulated time (default: 10)",
    )
    parser.add_argument(
        "--repeats",
        type=int,
        default=3,
        metavar="COUNT",
        help="flights of each peer, in turns (default: 3)",
    )
    parser.add_argument(
        "--steps",
        nargs="*",
        type=int,
        default=list(_STEPS),
        metavar="N",
        help=f"lengths of the horizon to fly {' and '.join(SWEPT)} with as well; without a "
        f"number that table is left out (default: {' '.join(map(str, _STEPS))})",
    )
    parser.add_argument(
        "--config",
        action="append",
        default=[],
        metavar="FILE",
        help="ROS parameter file or preset; may be repeated, later ones win",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NODE.PARAM=VALUE",
        dest="assignments",
        help="set one parameter for all peers, for example mpc.terminal_weight=10; may be "
        "repeated",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for {RESULT}, {PAGE} and {PICTURE}; must not hold any "
        "(default: runs/<date-time>_bench)",
    )


def resolve_bench(options: argparse.Namespace) -> BenchConfig:
    """Return what the options ask for; raises :class:`UserError` for what cannot be used."""
    _check(options)
    # The peers know the model only, and so does the controller then.
    made = [f"simulator.duration={options.duration}", "mpc.formulation=manifold"]
    made += ["mpc.estimate_disturbance=false"]
    made += [f"{node}.lockstep=true" for node in ("mpc", "simulator", "reference")]
    sources = options.config or ["default"]
    loaded = files.load(sources, [*made, *options.assignments], schema=SCHEMA)
    mpc = cast(MpcConfig, loaded["mpc"])
    if mpc.formulation != "manifold":
        raise UserError(
            f"--set: mpc.formulation: given {mpc.formulation!r}, expected manifold, on which the "
            "peers are compared; --peers paper flies the paper's"
        )
    _check_steps(mpc, options.steps)
    return BenchConfig(
        mpc=mpc,
        simulator=cast(SimulatorConfig, loaded["simulator"]),
        reference=cast(ReferenceConfig, loaded["reference"]),
        peers=list(dict.fromkeys(options.peers)),
        steps=sorted(set(options.steps)),
        repeats=options.repeats,
    )


def bench_command(options: argparse.Namespace) -> str:
    """Return the command that measures the same again; where results go is left out."""
    words = ["quad_mpc bench"]
    if options.peers != list(PEERS):
        words += ["--peers", *options.peers]
    words += [f"--duration {options.duration:g}", f"--repeats {options.repeats}"]
    words += ["--steps", *map(str, options.steps)]
    words += [f"--config {Path(source).name}" for source in options.config]
    words += [f"--set {assignment}" for assignment in options.assignments]
    return " ".join(words)


def _check(options: argparse.Namespace) -> None:
    for name in options.peers:
        if name not in PEERS:
            raise UserError(f"--peers: given {name!r}, expected some of {', '.join(PEERS)}")
    if not (math.isfinite(options.duration) and options.duration > 0.0):
        raise UserError(f"--duration: given {options.duration}, expected a number > 0")
    if options.repeats < 1:
        raise UserError(f"--repeats: given {options.repeats}, expected an integer >= 1")


def _check_steps(mpc: MpcConfig, lengths: Sequence[int]) -> None:
    for steps in lengths:
        try:
            dataclasses.replace(mpc, horizon_steps=steps)
        except ConfigurationError as error:
            raise UserError(f"--steps: given {steps}, expected {error.expected}") from error
