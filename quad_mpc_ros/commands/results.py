# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results of a run: summary, figures, printed table, exit code."""

from __future__ import annotations

import sys
from pathlib import Path

from quad_mpc_ros.analysis.figures import write_figures
from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import results_in, write_json
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.table import summary_table
from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
from quad_mpc_ros.recordings.recording import Recording


def finish(out: Path, *, wall_seconds: float) -> int:
    """Evaluate the bag in ``out``, write and print the results, and return the exit code.

    The code is 0 only if the MPC sent every command and the vehicle did not crash.
    """
    print("  evaluating the recording", file=sys.stderr, flush=True)
    flight = Recording(out / "bag").flight()
    summary = summarise(flight, wall_seconds=wall_seconds)
    with results_in(out):
        write_json(out / "summary.json", summary)
        figures = write_figures(flight, out / "figures")
    print(summary_table(summary))
    print(f"\nbag      {out / 'bag'}\nsummary  {out / 'summary.json'}")
    print(f"figures  {', '.join(str(path) for path in figures)}")
    verdict = verdict_on(summary)
    print(f"\nverdict  {verdict.line}")
    print("\n".join(f"to do    {each}" for each in verdict.advice))
    return 0 if verdict.good else EXIT_FAILED
