"""The measurements as a page of Markdown, with how they were made and on what."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.bench.peers import PEERS
from quad_mpc_ros.bench.tables import (
    as_markdown,
    comparison_lines,
    horizon_rows,
    peer_rows,
    swept,
)
from quad_mpc_ros.text_tables import markdown_table

_WIDTH = 99


def page(result: Mapping[str, Any], *, picture: str) -> str:
    """Return the page of a result; ``picture`` is its path as seen from the page."""
    parts = [
        "# Performance",
        _paragraph(
            "What a control step costs, beside other ways to solve the same problem. Everything "
            "here was measured in one process and one run by"
        ),
        f"```\n{result['command']}\n```",
        _paragraph(_how(result)),
        as_markdown(peer_rows(result)),
        *map(_paragraph, comparison_lines(result)),
        *(_paragraph(f"Skipped: {_skipped(*each)}") for each in result["skipped"].items()),
        _paragraph(_LEGEND),
    ]
    if swept(result):
        parts += [
            "## Against the length of the horizon",
            f"![Step time by peer and against the length of the horizon]({picture})",
            as_markdown(horizon_rows(result)),
        ]
    parts += [
        "## What is compared",
        "\n".join(map(_item, _PEERS_EXPLAINED)),
        "## Machine",
        _machine(result),
    ]
    return "\n\n".join(parts) + "\n"


_LEGEND = (
    "A whole step is odometry and reference in to command out, called from Python, for every peer "
    "by the same clock. The first step of each flight, on which solvers set themselves up, is not "
    "in p50, p99 and max; *first* is the longest of those. Iterations are summed over the solves "
    "of a step, of all steps. RMSE counts the jumps of the reference; *before switch* is the "
    "largest error just before one. Both are of the worst flight. OSQP's own time is the floor "
    "for what is built around OSQP. The MPC alone predicts, linearises, updates the QP, solves "
    "and applies; validation, safety ladder and limits, which no other peer has, are the rest."
)

_PEERS_EXPLAINED = (
    "**this controller**: `formulation: manifold` with all that the node does: validation, safety "
    "ladder, statistics.",
    "**the paper's formulation**: the same with `formulation: paper`, one linearisation held over "
    "the horizon.",
    "**acados**: the same problem (model, errors, weights, bounds, horizon, reference) as a C "
    "solver with one real-time iteration per step, partial condensing, HPIPM, and one explicit "
    "Runge-Kutta step of order 4 a stage. The whole step includes what its Python interface "
    "needs: sampling the reference, one call per stage to set it, the state, the solve, the "
    "input. Its iterations are HPIPM's.",
    "**cvxpy**: this controller's linearisation, its QP written down stage by stage and rebuilt "
    "at every step, solved by OSQP with the same tolerance.",
)


def _how(result: Mapping[str, Any]) -> str:
    s = result["settings"]
    return (
        f"The {s['trajectory']} on the plant `{s['dynamics']}`, {s['duration_s']:g} s at "
        f"{s['odom_rate_hz']:g} Hz, each peer {_times(s['repeats'])} in turns, "
        f"N = {s['horizon_steps']} steps of {s['horizon_step_s']:g} s, "
        f"Q = diag({_numbers(s['Q'])}), R = diag({_numbers(s['R'])}), terminal weight "
        f"{s['terminal_weight']:g}, OSQP's tolerance {s['solver_tolerance']:g}. Each peer flies "
        "its own closed loop; the garbage collector is on, and is run before each flight."
    )


def _machine(result: Mapping[str, Any]) -> str:
    return markdown_table(("", "measured on"), list(result["machine"].items()))


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _skipped(peer: str, reason: str) -> str:
    return f"{PEERS[peer].title}: {reason}."


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _paragraph(text: str) -> str:
    return textwrap.fill(text, _WIDTH, break_long_words=False, break_on_hyphens=False)


def _item(text: str) -> str:
    return textwrap.fill(
        text,
        _WIDTH,
        initial_indent="- ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
