# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc compile``: compile all code now, so that no node compiles when it starts."""

from __future__ import annotations

import argparse
import functools
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
    """Add the description and the option."""
    parser.description = (
        "Compile the machine code of the controller, the simulator and the references on all "
        "cores, and store it in the user's cache folder or in NUMBA_CACHE_DIR. The cache is valid "
        "for these sources, this Python, these libraries and this processor: run the command "
        "again after an update. If machine code is missing, a node compiles it first and logs "
        "that it does."
    )
    parser.add_argument("--again", action="store_true", help="empty the cache first")


def run(options: argparse.Namespace) -> int:
    """Compile missing functions; return the exit code."""
    folder = cache_folder()
    if folder is None:
        print(
            "error: compile cache: cannot write the cache, expected a writable folder; set "
            "NUMBA_CACHE_DIR to a writable folder",
            file=sys.stderr,
        )
        return 1
    complete = folder / "complete"  # skips the flights that look for missing functions
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
    print(f"all compiled: {cached_functions()} functions, {time.monotonic() - begun:.0f} s")
    return 0


def _compile(begun: float) -> None:
    """Compile in one process per core, starting with the parts that share least code.

    Two processes that compile the same function may overwrite each other's index, so the last part
    compiles everything.
    """
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.control.warm_up import compile_estimation, compile_problem

    cores = len(os.sched_getaffinity(0))
    stages: list[list[Callable[[], None]]] = [[_everything]]
    if cores > 1 and not cached_functions():
        problem = functools.partial(compile_problem, MpcConfig())
        estimation = functools.partial(compile_estimation, MpcConfig())
        stages.insert(0, [problem, estimation, _plants])
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


def _plants() -> None:
    from quad_mpc_ros.configuration import UserError
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.config import PLANTS, compile_plant

    for name, entry in PLANTS.items():
        preset = entry.preset or "default"
        try:
            config = load_config(preset, assignments=(f"simulator.plant={name}",))
            compile_plant(config.simulator)
        except (ImportError, UserError):  # the plant is not installed
            continue


def _everything() -> None:
    """Fly all presets briefly, with and without lags and estimation."""
    from quad_mpc_ros.recordings.evaluation.simulated import load_config
    from quad_mpc_ros.simulation.closed_loop import fly

    for preset, more in itertools.product(_PRESETS, ((), _NO_LAGS, _NO_ESTIMATION)):
        mpc, simulator, reference = load_config(
            preset, assignments=(_DURATION, *more, "mpc.lockstep=true")
        )
        for _ in fly(mpc=mpc, simulator=simulator, reference=reference):
            pass
    _plants()
