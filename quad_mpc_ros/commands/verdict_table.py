"""The verdict on a reference for a terminal."""

from __future__ import annotations

from quad_mpc_ros.trajectories.feasibility import Verdict

_NAME, _CELL = 22, 12


def verdict_table(verdict: Verdict) -> str:
    """Return the verdict as lines of plain ASCII text, at most 80 columns wide."""
    over_time = verdict.over_time
    head = "".join(f"{column:>{_CELL}}" for column in ("needed", "at", "limit", "left"))
    return "\n".join(
        (
            f"{'duration':<{_NAME}}{over_time.seconds[-1]:.2f} s",
            f"{'highest speed':<{_NAME}}{over_time.speed.max():.2f} m/s",
            f"{'highest acceleration':<{_NAME}}{over_time.acceleration.max():.2f} m/s^2",
            "",
            " " * (_NAME + 6) + head,
            *(
                f"{need.name:<{_NAME}}{need.unit.strip():<6}{need.worst:>{_CELL}.3f}"
                f"{f'{need.time:.3f} s':>{_CELL}}{need.limit:>{_CELL}.3f}"
                f"{need.margin:>{_CELL}.3f}"
                for need in verdict.needs
            ),
            "",
            "feasible" if verdict.feasible else f"not feasible: {verdict.reason()}",
        )
    )
