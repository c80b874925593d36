"""``quad_mpc bench``: this controller beside others, on the same flight in one process."""

from __future__ import annotations

import argparse
import dataclasses
import runpy
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.commands.output import default_out, prepared_out, results_in, write_json
from quad_mpc_ros.commands.run_options import add_config, add_out, add_set, check_duration
from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.experiments.bench import page as pages
from quad_mpc_ros.experiments.bench.peers import PeerKind

if TYPE_CHECKING:
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.experiments.bench.run import BenchConfig

RESULT, PAGE, PICTURE = "performance.json", "performance.md", "performance.png"
_STEPS = (5, 10, 20, 40)
_OWN = ("controller", "paper")
_PEER = "PEER"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what to compare, and for how long."""
    parser.description = (
        "Fly the square on the true rigid body with each peer in turn, in one process, and "
        "report what a step costs: this controller, others that a file defines, and the solvers' "
        "own times; then the cost against the length of the horizon. bench/peers in the sources "
        "has acados (SQP_RTI, HPIPM) and the same QP through cvxpy, rebuilt at every step; they "
        "need: pip install 'quad_mpc_ros[bench]'. Exit code 2 for bad input."
    )
    parser.add_argument(
        "--peers",
        nargs="+",
        default=list(_OWN),
        metavar="PEER",
        help=f"what to compare: {', '.join(_OWN)}, or the path of a Python file that defines a "
        "peer, such as bench/peers/acados.py; what it needs and is not installed is skipped with "
        f"a note (default: {' '.join(_OWN)})",
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
        help="lengths of the horizon to fly the controller with as well, and peers that say so; "
        f"without a number that table is left out (default: {' '.join(map(str, _STEPS))})",
    )
    add_config(parser)
    add_set(parser, "set one parameter for all peers, for example mpc.terminal_weight=10")
    add_out(parser, f"{RESULT}, {PAGE} and {PICTURE}; must not hold any", "bench")


def run(options: argparse.Namespace) -> int:
    """Fly the peers, write and show what was measured; return the exit code."""
    from quad_mpc_ros.experiments.bench.run import run as fly_peers
    from quad_mpc_ros.simulation.config import make_plant

    config = _configuration(options)
    make_plant(config.simulator)  # refuses one that is not installed before anything flies
    out = prepared_out(options.out or default_out("bench"), holds=(RESULT, PAGE, PICTURE))
    print(f"measuring into {out}", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="quad_mpc_bench_") as scratch:
        measured = fly_peers(config, scratch=Path(scratch), report=_report)
    result = {"command": _command_again(options), **measured}
    _write(result, out)
    _show(result, out)
    return 0


def _report(line: str) -> None:
    print(f"  {line}", file=sys.stderr, flush=True)


def _write(result: dict[str, Any], out: Path) -> None:
    from quad_mpc_ros.experiments.bench.picture import write_picture

    with results_in(out):
        write_json(out / RESULT, result)
        (out / PAGE).write_text(pages.page(result, picture=PICTURE), encoding="utf-8")
        write_picture(result, out / PICTURE)


def _show(result: dict[str, Any], out: Path) -> None:
    print(pages.as_text(pages.peer_rows(result)))
    for line in pages.comparison_lines(result):
        print(f"\n{line}")
    if pages.swept(result):
        print(f"\n{pages.as_text(pages.horizon_rows(result))}")
    print()
    for name in (RESULT, PAGE, PICTURE):
        print(out / name)


def _configuration(options: argparse.Namespace) -> BenchConfig:
    """Return what the options ask for; raises :class:`UserError` for what cannot be used."""
    from quad_mpc_ros.experiments.bench.run import BenchConfig
    from quad_mpc_ros.recordings.evaluation.simulated import load_config

    _check_options(options)
    # The peers know a model without lags only, and so does the controller then.
    made = [f"simulator.duration={options.duration}", "mpc.formulation=manifold"]
    made += ["mpc.estimate_disturbance=false", "mpc.input_delay=0", "simulator.command_delay=0"]
    lags = ("rate_time_constant", "thrust_time_constant")
    made += [f"{node}.{lag}=0" for node in ("mpc", "simulator") for lag in lags]
    made += [f"{node}.lockstep=true" for node in ("mpc", "simulator", "reference")]
    assignments = [*made, *options.assignments]
    config = load_config(*(options.config or ["agile"]), assignments=assignments)
    if config.mpc.formulation != "manifold":
        raise UserError(
            f"--set: mpc.formulation: given {config.mpc.formulation!r}, expected manifold, on "
            "which the peers are compared; --peers paper flies the paper's"
        )
    _check_steps(config.mpc, options.steps)
    return BenchConfig(
        mpc=config.mpc,
        simulator=config.simulator,
        reference=config.reference,
        peers=_peer_kinds(options.peers),
        steps=sorted(set(options.steps)),
        repeats=options.repeats,
    )


def _peer_kinds(given: Sequence[str]) -> dict[str, PeerKind]:
    """Return the peers of names and Python files, by name: that of a file is its stem.

    Raises :class:`UserError` for what is neither, and for a file that defines no peer.
    """
    from quad_mpc_ros.experiments.bench.controller import CONTROLLERS

    kinds: dict[str, PeerKind] = {}
    for word in dict.fromkeys(given):
        own = CONTROLLERS.get(word)
        name = word if own else Path(word).stem
        if name in kinds:
            raise UserError(f"--peers: {name} is given twice, expected peers of different names")
        kinds[name] = own or _defined(word)
    return kinds


def _defined(word: str) -> PeerKind:
    path = Path(word)
    if path.suffix != ".py" or not path.is_file():
        raise UserError(
            f"--peers: given {word!r}, expected {', '.join(_OWN)} or a Python file that defines a "
            "peer: bench/peers/acados.py or bench/peers/cvxpy.py of the sources, or one of yours"
        )
    try:
        found = runpy.run_path(str(path), run_name=f"peer_{path.stem}").get(_PEER)
    except Exception as error:  # whatever the file raises
        raise UserError(
            f"--peers: {path} cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(found, PeerKind):
        raise UserError(
            f"--peers: {path} has {_PEER} = {found!r}, expected a PeerKind of "
            f"{PeerKind.__module__}"
        )
    return found


def _command_again(options: argparse.Namespace) -> str:
    """Return the command that measures the same again; where results go is left out."""
    words = ["quad_mpc bench"]
    if options.peers != list(_OWN):
        words += ["--peers", *options.peers]
    words += [f"--duration {options.duration:g}", f"--repeats {options.repeats}"]
    words += ["--steps", *map(str, options.steps)]
    words += [f"--config {Path(source).name}" for source in options.config]
    words += [f"--set {assignment}" for assignment in options.assignments]
    return " ".join(words)


def _check_options(options: argparse.Namespace) -> None:
    check_duration(options.duration)
    if options.repeats < 1:
        raise UserError(f"--repeats: given {options.repeats}, expected an integer >= 1")


def _check_steps(mpc: MpcConfig, lengths: Sequence[int]) -> None:
    for steps in lengths:
        try:
            dataclasses.replace(mpc, horizon_steps=steps)
        except ConfigurationError as error:
            raise UserError(f"--steps: given {steps}, expected {error.expected}") from error
