"""The measurements as tables and as a page of Markdown, with how they were made and on what."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from quad_mpc_ros.configuration.text_tables import markdown_table, text_table

_WIDTH = 99
Rows = list[list[str]]
"""A header and the rows below it; the first cell of each is its label."""

_ABSENT = "-"
_PEER_HEADER = [
    "", "p50 [us]", "p99 [us]", "max [us]", "first [us]",
    "iterations p50 / p99 / max", "failed", "RMSE [m]", "before switch [m]",
]  # fmt: skip
_HORIZON_HEADER = [
    "N", "whole step of", "p50 [us]", "p99 [us]",
    "solver alone p50", "p99 [us]", "iterations p50 / p99 / max", "RMSE [m]",
]  # fmt: skip


def page(result: Mapping[str, Any], *, picture: str) -> str:
    """Return the page of a result; ``picture`` is its path as seen from the page."""
    parts = [
        "# Performance",
        _paragraph(
            "What a control step costs, beside other ways to solve the same problem. Everything "
            "here was measured in one process and one run by"
        ),
        f"```sh\n{result['command']}\n```",
        _paragraph(_how(result)),
        as_markdown(peer_rows(result)),
        *map(_paragraph, comparison_lines(result)),
        *(
            _paragraph(f"Skipped: {result['peers'][peer]['title']}: {reason}.")
            for peer, reason in result["skipped"].items()
        ),
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
        "\n".join(
            _paragraph(f"- **{name}**: {peer['description']}", indent="  ")
            for name, peer in result["peers"].items()
        ),
        "## A whole flight",
        _paragraph(_WHOLE_FLIGHT),
        "## Machine",
        markdown_table(("", "measured on"), list(result["machine"].items())),
    ]
    return "\n\n".join(parts) + "\n"


def peer_rows(result: Mapping[str, Any]) -> Rows:
    """Return each peer's whole step, and below it what the parts of it took."""
    rows = [_PEER_HEADER]
    for entry in compared(result):
        peer = result["peers"][entry["peer"]]
        rows.append(
            [
                peer["title"],
                *_times(entry["step_us"], "p50", "p99", "max"),
                f"{entry['first_step_us']:.0f}",
                _iterations(entry),
                str(entry["failed_steps"]),
                _metres(entry["position_rmse_m"]),
                _metres(entry["error_before_switch_m"]),
            ]
        )
        if entry["mpc_us"]["p50"] is not None:
            rows.append(_part("of that, the MPC alone", entry["mpc_us"]))
        rows.append(_part(f"of that, {peer['solver']}'s own time", entry["solve_us"]))
    return rows


def _part(label: str, times: Mapping[str, float | None]) -> list[str]:
    """Return a row with the times of a part of the step."""
    return [label, *_times(times, "p50", "p99", "max"), *[""] * (len(_PEER_HEADER) - 4)]


def horizon_rows(result: Mapping[str, Any]) -> Rows:
    """Return the cost against the length of the horizon."""
    rows = [_HORIZON_HEADER]
    for entry in swept(result):
        rows.append(
            [
                str(entry["horizon_steps"]),
                result["peers"][entry["peer"]]["title"],
                *_times(entry["step_us"], "p50", "p99"),
                *_times(entry["solve_us"], "p50", "p99"),
                _iterations(entry),
                _metres(entry["position_rmse_m"]),
            ]
        )
    return rows


def comparison_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the times of this controller over those of its solver and of each swept peer."""
    found = {entry["peer"]: entry for entry in compared(result)}
    ours = found.get("controller")
    if ours is None:
        return []
    lines = [
        "Whole step over OSQP's own time: "
        f"{_ratio(ours['step_us'], ours['solve_us'], 'p50')} at p50; the MPC alone: "
        f"{_ratio(ours['mpc_us'], ours['solve_us'], 'p50')}."
    ]
    for name in swept_peers(result):
        if name in found and name != "controller":
            theirs = found[name]["step_us"]
            lines.append(
                f"Whole step over that of {name}: {_ratio(ours['step_us'], theirs, 'p50')} at "
                f"p50, {_ratio(ours['step_us'], theirs, 'p99')} at p99."
            )
    return lines


def swept_peers(result: Mapping[str, Any]) -> list[str]:
    """Return the names of the peers that fly with other lengths of the horizon as well."""
    return [name for name, peer in result["peers"].items() if peer["swept"]]


def compared(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the entries of the table of peers."""
    steps = result["settings"]["horizon_steps"]
    return [entry for entry in result["entries"] if entry["horizon_steps"] == steps]


def swept(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the entries of the table against the horizon, by peer and length.

    There are none when only one length was flown.
    """
    order = swept_peers(result)
    entries = [entry for entry in result["entries"] if entry["peer"] in order]
    if len({entry["horizon_steps"] for entry in entries}) < 2:
        return []
    return sorted(entries, key=lambda entry: (order.index(entry["peer"]), entry["horizon_steps"]))


def as_text(rows: Rows) -> str:
    """Return rows as lines of plain text, the label to the left and numbers to the right."""
    return "\n".join(text_table(rows, align="l" + "r" * (len(rows[0]) - 1)))


def as_markdown(rows: Rows) -> str:
    """Return rows as a table of Markdown."""
    return markdown_table(rows[0], rows[1:], align="l" + "r" * (len(rows[0]) - 1))


def _times(values: Mapping[str, float | None], *names: str) -> list[str]:
    return [_ABSENT if (value := values[name]) is None else f"{value:.0f}" for name in names]


def _iterations(entry: Mapping[str, Any]) -> str:
    return " / ".join(_times(entry["iterations"], "p50", "p99", "max"))


def _metres(value: float | None) -> str:
    return _ABSENT if value is None else f"{value:.4f}"


def _ratio(over: Mapping[str, float | None], under: Mapping[str, float | None], name: str) -> str:
    numerator, denominator = over[name], under[name]
    return f"{numerator / denominator:.2f}" if numerator and denominator else _ABSENT


_LEGEND = (
    "A whole step is odometry and reference in to command out, called from Python, for every peer "
    "by the same clock. The first step of each flight, on which solvers set themselves up, is not "
    "in p50, p99 and max; *first* is the longest of those. Iterations are summed over the solves "
    "of a step, of all steps. RMSE counts the jumps of the reference; *before switch* is the "
    "largest error just before one. Both are of the worst flight. OSQP's own time is the floor "
    "for what is built around OSQP. The MPC alone predicts, linearises, updates the QP, solves "
    "and applies; validation, safety ladder and limits, which no other peer has, are the rest."
)

_WHOLE_FLIGHT = (
    "`python bench/closed_loop.py` prints how many times real time flights take that are "
    "simulated in one process, as a campaign flies them, and where the time of a step goes: the "
    "MPC, the controller around it, and plant, sensors and reference."
)


def _how(result: Mapping[str, Any]) -> str:
    s = result["settings"]
    repeats = "once" if s["repeats"] == 1 else f"{s['repeats']} times"
    return (
        f"The {s['trajectory']} on the plant `{s['dynamics']}`, {s['duration_s']:g} s at "
        f"{s['odom_rate_hz']:g} Hz, each peer {repeats} in turns, "
        f"N = {s['horizon_steps']} steps of {s['horizon_step_s']:g} s, "
        f"Q = diag({_numbers(s['Q'])}), R = diag({_numbers(s['R'])}), terminal weight "
        f"{s['terminal_weight']:g}, OSQP's tolerance {s['solver_tolerance']:g}. Each peer flies "
        "its own closed loop; the garbage collector is on, and is run before each flight."
    )


def _numbers(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _paragraph(text: str, *, indent: str = "") -> str:
    return textwrap.fill(
        text,
        _WIDTH,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
