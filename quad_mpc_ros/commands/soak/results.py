"""The results of a soak: the table on the screen, ``soak.json`` and one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.analysis.figures.over_time import draw_panel, label_time
from quad_mpc_ros.analysis.figures.panels import LEVELS, Curve, Panel
from quad_mpc_ros.commands.output import results_in, write_json
from quad_mpc_ros.commands.run_configuration import RunConfig
from quad_mpc_ros.commands.soak.campaign import Outcome
from quad_mpc_ros.commands.soak.endurance import PERIODS_TO_CATCH_UP
from quad_mpc_ros.commands.soak.rig import Rig
from quad_mpc_ros.configuration.text_tables import labelled, text_table
from quad_mpc_ros.control.config import MpcConfig

_WIDTH, _NAME = 99, 27
_FIGURE_WIDTH, _FIGURE_HEIGHT = 10.0, 6.0  # inch
_LATENESS = (0.1, 1e3)  # ms, on the axis
GOOD, BAD = "holds", "FAILS"


def write_results(
    run: RunConfig,
    found: dict[str, Any],
    rig: Rig,
    *,
    files: tuple[str, str],
    wrong: list[str],
    outcomes: Sequence[Outcome] = (),
) -> None:
    """Write what was found and a picture of it into two files in the folder of the run.

    Raises :class:`UserError` when that fails.
    """
    result = {
        "holds": not wrong and not any(outcome.complaints for outcome in outcomes),
        "complaints": wrong,
        **found,
        "config": {
            node: getattr(run, node).flattened() for node in ("mpc", "simulator", "reference")
        },
    }
    with results_in(run.out):
        write_json(run.out / files[0], result)
        if rig.watch.ticks:
            _write_picture(rig, run.mpc, outcomes, run.out / files[1])


def outcome_lines(outcome: Outcome) -> list[str]:
    """Return a fault's row of the table, and its complaints."""
    word = BAD if outcome.complaints else GOOD
    head = f"{outcome.fault.name:<{_NAME}}{word}  "
    lines = labelled(head, outcome.seen, indent=len(head), width=_WIDTH)
    for complaint in outcome.complaints:
        lines += labelled("", complaint, indent=_NAME, width=_WIDTH)
    return lines


def outcome_figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return what became of each fault, for ``soak.json``."""
    return {
        outcome.fault.name: {
            "holds": not outcome.complaints,
            "complaints": outcome.complaints,
            "seen": outcome.seen,
        }
        for outcome in outcomes
    }


def endurance_table(figures: dict[str, Any]) -> str:
    """Return the figures of an endurance as lines of text."""
    latency, memory = figures["odom_to_stats_ms"], figures["memory_mb"]
    sources = ", ".join(f"{source} {count}" for source, count in figures["sources"].items())
    rows = {
        "flight": f"{figures['duration_s']:.0f} s, {figures['parameter_changes']} changes of "
        "parameters",
        "ticks": f"{figures['ticks']}: {sources}",
        "late by a period": f"{figures['late_ticks']}, and {figures['unanswered_odometries']} "
        "odometries unanswered",
        "the machine": _machine_text(figures["machine"]),
        "odometry to tick": ", ".join(
            f"{name} {ms:.2f} ms" for name, ms in latency.items() if ms is not None
        ),
        "unsound commands": f"{figures['unsound_commands']}",
        "memory": _memory_text(memory),
    }
    return "\n".join(text_table(list(rows.items()), align="ll", widths=(21, 0), gap=""))


def _machine_text(machine: dict[str, Any] | None) -> str:
    if machine is None:
        return "not watched"
    return (
        f"a bare timer was late by a period {machine['late_wakes']} times of {machine['wakes']}, "
        f"up to {machine['latest_ms']:.0f} ms; {machine['late_ticks_then']} of the above came "
        f"within {PERIODS_TO_CATCH_UP} periods of it, {machine['share_of_time']:.2%} of the time"
    )


def _memory_text(memory: dict[str, float | None]) -> str:
    if memory["warm"] is None or memory["growth"] is None:
        return "too short to judge"
    return f"{memory['warm']:.1f} MB once warm, grown by {memory['growth']:+.2f} MB since"


def _write_picture(rig: Rig, config: MpcConfig, outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw the sources of commands, lateness and memory; raises ``OSError``."""
    start_ns = rig.watch.ticks[0].sent_ns  # that of the flight, not of starts before it
    figure = style.new_figure(_FIGURE_WIDTH, _FIGURE_HEIGHT, dpi=120)
    column = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    for axes, panel in zip(column, _panels(rig, config, start_ns), strict=True):
        draw_panel(axes, panel)
    rungs, late, memory = column
    for outcome in outcomes:
        begin, end = ((when - start_ns) * 1e-9 for when in (outcome.began_ns, outcome.ended_ns))
        if begin < 0.0:
            continue
        for axes in column:
            axes.axvspan(begin, end, color=style.REFERENCE, alpha=0.25, linewidth=0.0)
        name = outcome.fault.name
        rungs.text(begin, len(LEVELS), name, fontsize=5, rotation=90, va="top", ha="right")
    rungs.set_ylim(-0.3, len(LEVELS))
    late.set_ylim(*_LATENESS)
    style.title(rungs, "Who commanded")
    label_time(memory)
    style.save(figure, path)


def _panels(rig: Rig, config: MpcConfig, start_ns: int) -> list[Panel]:
    ticks = rig.watch.ticks
    time = np.array([(tick.sent_ns - start_ns) * 1e-9 for tick in ticks])
    level = np.array([LEVELS.index(tick.source) for tick in ticks])
    lateness = np.maximum(rig.watch.lateness_ms(), 1e-2)
    memory = np.array([(when, used) for when, used in rig.memory if when >= start_ns])
    memory = memory.reshape(-1, 2)
    used = Curve(name="", time=(memory[:, 0] - start_ns) * 1e-9, values=1e-6 * memory[:, 1])
    return [
        Panel(name="", curves=[Curve(name="", time=time, values=level, held=True)], levels=LEVELS),
        Panel(
            name="odometry to tick",
            unit="ms",
            curves=[Curve(name="", time=time, values=lateness, weight="fine")],
            bounds=(1e3 / config.control_rate,),
            logarithmic=True,
        ),
        Panel(name="memory", unit="MB", curves=[used]),
    ]
