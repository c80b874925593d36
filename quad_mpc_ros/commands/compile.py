"""``quad_mpc compile``: makes all machine code now, so that no node has to when it starts."""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait

from quad_mpc_ros.configuration.compilation import cache_folder, cached_functions

_PRESETS = ("default", "agile", "paper", "paper_rigid_body", "vehicles/racer", "vehicles/sun_2022")
_NO_LAGS = ("mpc.rate_time_constant=0.0", "mpc.thrust_time_constant=0.0", "mpc.input_delay=0.0")
_NO_ESTIMATION = ("mpc.estimate_disturbance=false",)
_DURATION = "simulator.duration=0.4"
_PROGRESS_PERIOD = 5.0  # s


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command is."""
    parser.description = (
        "Compile the machine code of the controller, the simulator and the references on all "
        "cores, and keep it in the user's cache folder or in NUMBA_CACHE_DIR. The cache is valid "
        "for these sources, this Python, these libraries and this processor: run it again after "
        "an update. If machine code is missing, a node compiles it first and logs that it does."
    )
    parser.add_argument("--again", action="store_true", help="empty the cache first")


def run(options: argparse.Namespace) -> int:
    """Compile what is missing; return the exit code."""
    folder = cache_folder()
    if folder is None:
        print(
            "error: compile cache: cannot write it, expected a writable folder; "
            "set NUMBA_CACHE_DIR to one",
            file=sys.stderr,
        )
        return 1
    complete = folder / "complete"  # spares the flights that look for missing functions
    if options.again:
        shutil.rmtree(folder)
        folder.mkdir()
    elif complete.exists():
        print("all is compiled")
        return 0
    begun = time.monotonic()
    try:
        _compile(begun)
    except Exception as error:  # of any part, or because a process crashed
        print(
            f"error: compiling failed: {error}; if {folder} is damaged, run "
            "quad_mpc compile --again",
            file=sys.stderr,
        )
        return 1
    complete.touch()
    os.sync()  # a truncated file would crash the nodes that load it
    print(f"all is compiled: {cached_functions()} functions, {time.monotonic() - begun:.0f} s")
    return 0


def _compile(begun: float) -> None:
    """Compile in one process per core, first the parts that share least; raise what fails.

    Two processes that compile the same function may overwrite each other's index, so the last part
    is everything.
    """
    cores = len(os.sched_getaffinity(0))
    stages: list[list[Callable[[], None]]] = [[_everything]]
    if cores > 1 and not cached_functions():
        stages.insert(0, [_problem, _estimation, _plants])
        print(f"compiling on {cores} cores; the first time takes most of a minute", flush=True)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(cores, len(stages[0])), mp_context=context) as pool:
        for stage in stages:
            running: set[Future[None]] = {pool.submit(part) for part in stage}
            while running:
                done, running = wait(running, timeout=_PROGRESS_PERIOD)
                seconds = time.monotonic() - begun
                print(f"  {cached_functions()} functions after {seconds:.0f} s", flush=True)
                for part in done:
                    part.result()


def _problem() -> None:
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.control.warm_up import compile_problem

    compile_problem(MpcConfig())


def _estimation() -> None:
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.control.warm_up import compile_estimation

    compile_estimation(MpcConfig())


def _plants() -> None:
    from quad_mpc_ros.configuration import UserError
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.config import PLANTS, compile_plant

    for name, entry in PLANTS.items():
        preset = entry.preset or "default"
        try:
            config = load_config(preset, assignments=(f"simulator.plant={name}",))
            compile_plant(config.simulator)
        except (ImportError, UserError):  # it is not installed
            continue


def _everything() -> None:
    """Fly a little of everything."""
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.closed_loop import fly

    for preset, more in itertools.product(_PRESETS, ((), _NO_LAGS, _NO_ESTIMATION)):
        mpc, simulator, reference = load_config(
            preset, assignments=(_DURATION, *more, "mpc.lockstep=true")
        )
        for _ in fly(mpc=mpc, simulator=simulator, reference=reference):
            pass
    _plants()
