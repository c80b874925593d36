"""When somebody else than the MPC commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.evaluation.metrics import FALLBACKS
from quad_mpc_ros.report.run import ReportedRun
from quad_mpc_ros.safety.ladder import Source

WITHOUT_MPC = (*FALLBACKS, Source.SILENT.name.lower())


@dataclass(frozen=True, kw_only=True)
class Span:
    """A time, from ``start`` to ``end`` [s], in which ``source`` commanded, and why at first."""

    start: float
    end: float
    source: str
    reason: str


def fallback_spans(run: ReportedRun) -> list[Span]:
    """Return the spans without the MPC, in order: each until the first tick of another source."""
    sources = run.flight.stats["source"]
    if len(sources) == 0:
        return []
    begins = np.flatnonzero(np.append(True, sources[1:] != sources[:-1]))
    ends = np.append(run.tick_time[begins[1:]], run.flight.time[-1])
    return [
        Span(
            start=float(run.tick_time[begin]),
            end=float(end),
            source=str(sources[begin]),
            reason=str(run.flight.stats["reason"][begin]),
        )
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
        if sources[begin] in WITHOUT_MPC
    ]
