# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether a control step takes longer than it did: two installations, run by turns.

    python tools/compare_steps.py [--pairs 10] OLD_PYTHON NEW_PYTHON [-- OPTIONS of simulate]

Both Pythons have quad_mpc_ros installed, in environments of their own. Each pair of runs of
``quad_mpc simulate`` flies the same flight, the old one first in every other pair, and gives the
ratios new / old of the p50 and the p99 of the time from reference and odometry to the command, by
the calls of the controller: what a summary reports as step begins elsewhere in some versions. A
machine that is busy for a while is so for both runs of a pair, hence the median of the ratios
separates a change from the machine. With ``--cold`` 20 ms pass between two steps, as in flight,
and the caches hold other data.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import NamedTuple

FLIGHT = """
import json, sys, time
from quad_mpc_ros.cli import main
from quad_mpc_ros.control.controller import Controller

pause, times, passed = float(sys.argv[1]), [], [0.0]

def timed(method, pause):
    def call(*arguments, **named):
        time.sleep(pause)
        begun = time.perf_counter()
        tick = method(*arguments, **named)
        passed[0] += time.perf_counter() - begun
        if tick is not None:
            times.append(1e6 * passed[0])
            passed[0] = 0.0
        return tick
    return call

Controller.receive_reference = timed(Controller.receive_reference, 0.0)
Controller.receive_odometry = timed(Controller.receive_odometry, pause)
main(["simulate", *sys.argv[2:]])
times.sort()
print(json.dumps([times[len(times) // 2], times[len(times) * 99 // 100]]))
"""


class StepTimes(NamedTuple):
    """Times of the controller for a command [us]."""

    p50: float
    p99: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("old", type=Path, help="python of one environment")
    parser.add_argument("new", type=Path, help="python of the other one")
    parser.add_argument("--pairs", type=int, default=10, help="pairs of runs (default: 10)")
    parser.add_argument("--cold", action="store_true", help="pause between steps, as in flight")
    parser.add_argument("simulate", nargs="*", help="options of quad_mpc simulate, after --")
    options = parser.parse_args()
    if options.pairs < 1:
        parser.error(f"--pairs: given {options.pairs}, expected a number >= 1")
    pause = 0.02 if options.cold else 0.0
    measured = partial(step_times, options=options.simulate, pause=pause)
    for name in ("old", "new"):
        python = getattr(options, name)
        print(f"{name}  {package_of(python)}")
        measured(python)  # its code may have to be compiled
    pairs = []
    for number in range(options.pairs):
        print(f"pair {number + 1} of {options.pairs}", file=sys.stderr, flush=True)
        order = [options.old, options.new] if number % 2 == 0 else [options.new, options.old]
        times = {python: measured(python) for python in order}
        pairs.append((times[options.old], times[options.new]))
    print(table(pairs))


def package_of(python: Path) -> str:
    """Return the path from which a Python imports the package."""
    ended = run(python, "-c", "import quad_mpc_ros; print(quad_mpc_ros.__path__[0])")
    if ended.returncode:
        raise SystemExit(f"{python}: {ended.stderr}")
    return ended.stdout.strip()


def step_times(python: Path, options: list[str], *, pause: float) -> StepTimes:
    """Fly once with a pause [s] before each odometry, and return the times of the controller."""
    with tempfile.TemporaryDirectory() as folder:
        ended = run(python, "-c", FLIGHT, str(pause), *options, "--out", f"{folder}/run")
    if ended.returncode:
        raise SystemExit(f"{python}: {ended.stderr}")
    return StepTimes(*json.loads(ended.stdout.splitlines()[-1]))


def run(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a Python that sees its own environment only."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
    }
    return subprocess.run(
        [python, "-P", *arguments], capture_output=True, text=True, check=False, env=environment
    )


def table(pairs: list[tuple[StepTimes, StepTimes]]) -> str:
    """Return the table of pairs old, new: their times, ratios, and the medians of each."""
    lines = [
        "       p50 [us]                p99 [us]",
        "pair     old     new  new/old     old     new  new/old",
    ]
    rows = [
        [value for a, b in zip(old, new, strict=True) for value in (a, b, b / a)]
        for old, new in pairs
    ]
    medians = [statistics.median(column) for column in zip(*rows, strict=True)]
    names = [*(str(number + 1) for number in range(len(rows))), "median"]
    for name, row in zip(names, [*rows, medians], strict=True):
        cells = "".join(
            f"{value:9.3f}" if column % 3 == 2 else f"{value:8.0f}"
            for column, value in enumerate(row)
        )
        lines.append(f"{name:5}{cells[1:]}" if len(name) > 4 else f"{name:4}{cells}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
