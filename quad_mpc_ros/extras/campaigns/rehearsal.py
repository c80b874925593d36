# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Margins of a configuration: model errors from which a disturbed vehicle still recovers.

Disturbed vehicles fly with increasing model errors, until one does not recover. The verdict is
ready, marginal or not ready, with reasons and advice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from quad_mpc_ros.configuration import files
from quad_mpc_ros.configuration.text_tables import text_table
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.campaign_file import Overrides, campaign_from
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched
from quad_mpc_ros.recordings.evaluation.crash import crash_text
from quad_mpc_ros.simulation.config import SimulatorConfig

VEHICLES = 6
_BISECTION_STEPS = 5
_RECOVERED_ERROR = 0.5  # m at most in the last seconds, of a vehicle that recovered
_RECOVERED_TILT = 0.26  # rad; tilted further in hover it oscillates
_DURATION, _SETTLE_TIME = 8.0, 5.5  # s

DISTURBED: dict[str, Any] = {
    "flights": VEHICLES,
    "seed": 1,
    "settle_time": _SETTLE_TIME,
    "start": "reference",
    "set": {
        "simulator.position_noise": 0.003,
        "simulator.attitude_noise": 0.003,
        "simulator.velocity_noise": 0.02,
        "simulator.rate_noise": 0.02,
        "simulator.gust_intensity": 0.5,
    },
    "vary": {
        # Around the hover at 2 m: displaced by about a metre, moving, tilted.
        "simulator.initial_position": {"uniform": [[-1.0, -1.0, 1.5], [1.0, 1.0, 2.5]]},
        "simulator.initial_velocity": {"uniform": [[-1.0, -1.0, -0.5], [1.0, 1.0, 0.5]]},
        "simulator.initial_attitude": {"attitude": [0.26, 0.0]},
        "simulator.seed": {"integers": [0, 1000000]},
    },
}
"""Campaign of the disturbed vehicles, equal for all model errors."""

_ASSIGNED_CHANGES = (
    "reference.trajectory=hover",
    "reference.mode=at_once",
    "reference.height=2.0",
    f"simulator.duration={_DURATION}",
)

_LAG_TEXT = (
    "measure lags and delay with quad_mpc identify (docs/howto/identify.md), use the weights of "
    "default, or raise R of the body rates (docs/howto/tune.md)"
)
_MASS_TEXT = "weigh the vehicle, and set thrust_curve from a thrust stand or its hover throttle"
READY, MARGINAL, NOT_READY = "ready", "marginal", "not ready"


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A difference between the simulated and the configured vehicle.

    Attributes:
        name: Name in tables.
        parameter: Parameter of the simulator that changes.
        change: ``plus`` adds the difference, ``times`` scales by 1 plus the difference.
        sign: Sign of the difference.
        most: Largest difference, in s or as a share.
        ready: Margin needed to be ready to fly.
        marginal: Smallest margin for a careful flight.
        advice: Remedy for a margin that is too small.
    """

    name: str
    parameter: str
    change: Literal["plus", "times"]
    sign: float = 1.0
    most: float
    ready: float
    marginal: float
    advice: str

    def changed(self, nominal: Any, by: float) -> Any:
        """Return the parameter of a vehicle with a difference."""
        if self.change == "times":
            return nominal * (1.0 + self.sign * by)
        if isinstance(nominal, tuple):
            return [max(each + self.sign * by, 0.0) for each in nominal]
        return max(nominal + self.sign * by, 0.0)

    def text(self, by: float) -> str:
        """Return a difference with its unit."""
        return f"{1e3 * by:.0f} ms" if self.change == "plus" else f"{100.0 * by:.0f} %"


_LATER: dict[str, Any] = {
    "change": "plus",
    "most": 0.2,
    "ready": 0.04,
    "marginal": 0.015,
    "advice": _LAG_TEXT,
}
_SCALED: dict[str, Any] = {
    "change": "times",
    "most": 0.6,
    "ready": 0.2,
    "marginal": 0.1,
    "advice": _MASS_TEXT,
}
_DIRECTIONS = (
    Direction(name="body rates lag more", parameter="rate_time_constant", **_LATER),
    Direction(name="thrust lags more", parameter="thrust_time_constant", **_LATER),
    Direction(name="delay is longer", parameter="command_delay", **_LATER),
    Direction(name="thrust is less", parameter="thrust_scale", sign=-1.0, **_SCALED),
    Direction(name="thrust is more", parameter="thrust_scale", **_SCALED),
    Direction(name="mass is more", parameter="mass_scale", **_SCALED),
)


def directions_of(simulator: SimulatorConfig) -> list[Direction]:
    """Return the possible differences of a simulated vehicle.

    Plants with their own lags have no parameters for them. A modelled delay may also be shorter.
    """
    own = simulator.entry().has_own
    found = [each for each in _DIRECTIONS if each.parameter not in own]
    delay = simulator.command_delay
    if delay > 0.0:
        shorter = Direction(
            name="delay is shorter",
            parameter="command_delay",
            change="plus",
            sign=-1.0,
            most=delay,
            ready=min(0.04, delay),
            marginal=min(0.015, delay),
            advice="configure a shorter input_delay (docs/tutorials/first_flight.md)",
        )
        found.insert(len(found) - 3, shorter)
    return found


@dataclass(frozen=True, kw_only=True)
class Lost:
    """A disturbed vehicle that did not recover, and the reason.

    ``parameter_file`` repeats the flight.
    """

    number: int
    reason: str
    parameter_file: str = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The tolerated model error of one direction.

    ``margin`` is the largest difference with which every vehicle recovered, or the end of the
    search. ``lost`` is a vehicle that did not recover just beyond the margin, if any.
    """

    direction: Direction
    margin: float
    lost: Lost | None

    @property
    def text(self) -> str:
        """The margin with its unit."""
        shown = self.direction.text(self.margin)
        return f"{shown} or more" if self.lost is None else shown

    @property
    def word(self) -> str:
        """The verdict on the margin."""
        if self.margin >= self.direction.ready:
            return READY
        return MARGINAL if self.margin >= self.direction.marginal else NOT_READY


@dataclass(frozen=True, kw_only=True)
class Rehearsal:
    """The lost vehicles as configured, and the limits; empty if a vehicle did not recover."""

    lost: Sequence[Lost]
    limits: Sequence[Limit]


Observer = Callable[[str], None]
"""Called with a text about the next flights."""


def rehearse(
    config: Sequence[str], assignments: Sequence[str], engine: LocalWorkers, observe: Observer
) -> Rehearsal:
    """Fly the vehicles as configured, then search the limit of each direction by bisection.

    ``config`` are parameter files and presets, ``assignments`` are ``node.parameter=value``. The
    result does not depend on the number of workers. Raises :class:`UserError`.
    """

    def lost(*changes: str) -> list[Lost]:
        campaign = disturbed_campaign(config, [*assignments, *changes])
        return _lost(campaign, engine)

    observe("as configured")
    simulator = disturbed_campaign(config, assignments).base["simulator"]
    assert isinstance(simulator, SimulatorConfig)
    as_configured = lost()
    limits: list[Limit] = []
    directions = [] if as_configured else directions_of(simulator)
    for number, direction in enumerate(directions, start=1):

        def lost_by(
            by: float, direction: Direction = direction, number: int = number
        ) -> list[Lost]:
            place = f"{number} of {len(directions)}"
            observe(f"{place}: {direction.name} by {direction.text(by)}")
            value = direction.changed(getattr(simulator, direction.parameter), by)
            return lost(f"simulator.{direction.parameter}={files.value_text(value)}")

        limits.append(limit_of(direction, lost_by))
    return Rehearsal(lost=as_configured, limits=limits)


def limit_of(direction: Direction, lost_by: Callable[[float], Sequence[Lost]]) -> Limit:
    """Return the limit of a direction by bisection; ``lost_by`` flies a difference."""
    margin, beyond = 0.0, direction.most
    lost = lost_by(beyond)
    if not lost:
        return Limit(direction=direction, margin=beyond, lost=None)
    for _ in range(_BISECTION_STEPS):
        by = 0.5 * (margin + beyond)
        if found := lost_by(by):
            beyond, lost = by, found
        else:
            margin = by
    return Limit(direction=direction, margin=margin, lost=lost[0])


def disturbed_campaign(config: Sequence[str], assignments: Sequence[str]) -> Campaign:
    """Return the disturbed vehicles as a campaign. Raises :class:`UserError`."""
    overrides = Overrides(config=config, assignments=[*_ASSIGNED_CHANGES, *assignments])
    return campaign_from(DISTURBED, overrides, where="rehearse")


def _lost(campaign: Campaign, engine: LocalWorkers) -> list[Lost]:
    batches = batched(range(campaign.flights), workers=engine.workers)
    lost = [
        Lost(number=int(flight.row["flight"]), reason=reason, parameter_file=flight.parameter_file)
        for batch in engine.fly(campaign, batches)
        for flight in batch
        if (reason := _why_lost(flight.row))
    ]
    return sorted(lost, key=lambda each: each.number)


def _why_lost(row: Any) -> str:
    """Return why a vehicle did not recover, else an empty string."""
    if row.get("error"):
        return str(row["error"])
    if row["crashed"]:
        return crash_text(row["crash"], row["crash_time_s"])
    if row["fallbacks"]:
        return f"the failsafe was active {row['fallbacks']} times"
    if row["settled_error_max_m"] > _RECOVERED_ERROR:
        return f"error {row['settled_error_max_m']:.1f} m after {_SETTLE_TIME:g} s"
    if row["settled_tilt_max_rad"] > _RECOVERED_TILT:
        return f"tilt {row['settled_tilt_max_rad']:.2f} rad after {_SETTLE_TIME:g} s"
    return ""


@dataclass(frozen=True, kw_only=True)
class RehearsalVerdict:
    """The verdict in a word, its reasons, and advice."""

    word: str
    reasons: Sequence[str]
    advice: Sequence[str]


def verdict_on(rehearsal: Rehearsal) -> RehearsalVerdict:
    """Return the verdict of a rehearsal."""
    if rehearsal.lost:
        first = rehearsal.lost[0]
        return RehearsalVerdict(
            word=NOT_READY,
            reasons=[
                f"as configured, {len(rehearsal.lost)} of {VEHICLES} disturbed vehicles did not "
                f"recover: vehicle {first.number}: {first.reason}"
            ],
            advice=[
                "compare the vehicle file with the table of docs/tutorials/first_flight.md",
                "use the weights of default, or set omega_max and limits.tilt_max lower "
                "(docs/howto/tune.md)",
            ],
        )
    small = [limit for limit in rehearsal.limits if limit.word != READY]
    words = {limit.word for limit in small}
    return RehearsalVerdict(
        word=NOT_READY if NOT_READY in words else MARGINAL if small else READY,
        reasons=[_reason(limit) for limit in small]
        or ["every disturbed vehicle recovered, with the margins of the table"],
        advice=list(dict.fromkeys(limit.direction.advice for limit in small))
        or ["test on the bench without propellers, then hover (docs/tutorials/first_flight.md)"],
    )


def _reason(limit: Limit) -> str:
    direction, lost = limit.direction, limit.lost
    why = f"; beyond, vehicle {lost.number}: {lost.reason}" if lost is not None else ""
    return (
        f"{direction.name}: margin {direction.text(limit.margin)}, needed "
        f"{direction.text(direction.ready)}{why}"
    )


def rehearsal_table(rehearsal: Rehearsal) -> str:
    """Return the margins as a table for a terminal."""
    rows = [["the true vehicle", "margin", "needed", "verdict"]]
    for limit in rehearsal.limits:
        needed = limit.direction.text(limit.direction.ready)
        rows.append([limit.direction.name, limit.text, needed, limit.word])
    return "\n".join(text_table(rows, align="lrrl"))
