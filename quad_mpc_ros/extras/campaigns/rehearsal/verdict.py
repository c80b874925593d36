"""Verdict of a rehearsal: ready, marginal or not ready, with reasons and advice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.campaigns.rehearsal.rehearsal import Limit, Point, Rehearsal

READY, MARGINAL, NOT_READY = "ready", "marginal", "not ready"


@dataclass(frozen=True, kw_only=True)
class RehearsalVerdict:
    """The verdict in a word, its reasons, and advice."""

    word: str
    reasons: Sequence[str]
    advice: Sequence[str]


def verdict_on(rehearsal: Rehearsal) -> RehearsalVerdict:
    """Return the verdict of a rehearsal."""
    guess = rehearsal.guess
    if guess.lost:
        return RehearsalVerdict(
            word=NOT_READY,
            reasons=[
                f"as configured, {len(guess.lost)} of {len(guess.flown)} disturbed vehicles did "
                f"not recover: vehicle {guess.lost[0].number}: {guess.lost[0].lost}"
            ],
            advice=[
                "compare the vehicle file with the table of docs/tutorials/first_flight.md",
                "use the weights of default, or set omega_max and limits.tilt_max lower "
                "(docs/howto/tune.md)",
            ],
        )
    small = [limit for limit in rehearsal.limits if limit.margin < limit.direction.ready]
    tiny = [limit for limit in small if limit.margin < limit.direction.marginal]
    return RehearsalVerdict(
        word=NOT_READY if tiny else MARGINAL if small else READY,
        reasons=[_reason(limit) for limit in small]
        or ["every disturbed vehicle recovered, with the margins of the table"],
        advice=list(dict.fromkeys(limit.direction.advice for limit in small))
        or ["test on the bench without propellers, then hover (docs/tutorials/first_flight.md)"],
    )


def _reason(limit: Limit) -> str:
    direction, lost = limit.direction, limit.first_lost
    why = f"; beyond, vehicle {lost.number}: {lost.lost}" if lost is not None else ""
    return (
        f"{direction.name}: margin {direction.text(limit.margin)}, needed "
        f"{direction.text(direction.ready)}{why}"
    )


def rehearsal_table(rehearsal: Rehearsal) -> str:
    """Return the margins as a table for a terminal."""
    rows = [["the true vehicle", "margin", "needed", "verdict"]]
    for limit in rehearsal.limits:
        needed = limit.direction.text(limit.direction.ready)
        rows.append([limit.direction.name, limit.text, needed, _word(limit)])
    return "\n".join(text_table(rows, align="lrrl"))


def rehearsal_figures(rehearsal: Rehearsal) -> dict[str, Any]:
    """Return verdict, margins and all vehicles for JSON."""
    verdict = verdict_on(rehearsal)
    return {
        "verdict": verdict.word,
        "reasons": list(verdict.reasons),
        "advice": list(verdict.advice),
        "guess": _vehicles(rehearsal.guess),
        "margins": {
            limit.direction.name: {
                "parameter": f"simulator.{limit.direction.parameter}",
                "unit": "s" if limit.direction.change == "plus" else "share",
                "margin": limit.margin,
                "bounded": limit.bounded,
                "needed": limit.direction.ready,
                "verdict": _word(limit),
                "points": [
                    {"by": point.by, "vehicles": _vehicles(point)} for point in limit.points
                ],
            }
            for limit in rehearsal.limits
        },
    }


def _word(limit: Limit) -> str:
    if limit.margin >= limit.direction.ready:
        return READY
    return MARGINAL if limit.margin >= limit.direction.marginal else NOT_READY


def _vehicles(point: Point) -> list[dict[str, Any]]:
    return [{"settled_error_max_m": each.error, "lost": each.lost} for each in point.flown]
