"""What a run leaves behind: summary, figures, the table on the screen, the exit code."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.evaluation.flight import read_flight
from quad_mpc_ros.evaluation.metrics import summarise
from quad_mpc_ros.evaluation.table import summary_table
from quad_mpc_ros.figures.flight_figures import write_figures

EXIT_FAILSAFE = 1


def finish(out: Path, *, wall_seconds: float) -> int:
    """Evaluate the bag in ``out``, write and show the results, and return the exit code.

    It is 0 only when the MPC itself gave every command.
    """
    print("  evaluating the recording", file=sys.stderr, flush=True)
    flight = read_flight(out / "bag")
    summary = summarise(flight, wall_seconds=wall_seconds)
    try:
        text = json.dumps(summary, indent=2, allow_nan=False)
        (out / "summary.json").write_text(text + "\n", encoding="utf-8")
        figures = write_figures(flight, out / "figures")
    except OSError as error:
        raise UserError(f"{out}: results cannot be written: {error.strerror}") from error
    print(summary_table(summary))
    print(f"\nbag      {out / 'bag'}\nsummary  {out / 'summary.json'}")
    print(f"figures  {', '.join(str(path) for path in figures)}")
    failure = _failure(summary)
    if failure:
        print(f"\n{failure}", file=sys.stderr)
        return EXIT_FAILSAFE
    return 0


def _failure(summary: dict[str, Any]) -> str:
    """Return why a flight was not one of the MPC's alone, or nothing."""
    if not summary["commands"]:
        return "No command was given: see the solver status in mpc/stats."
    if summary["fallbacks"]:
        return f"The failsafe commanded {summary['fallbacks']} times: see reason in mpc/stats."
    if summary["solver_failures"]:
        return f"{summary['solver_failures']} solves failed: see the solver status in mpc/stats."
    return ""
