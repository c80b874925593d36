# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly configurations from soft to agile and draw accuracy against margin: docs/howto/tune.md.

python bench/front.py [--flights 40] [--workers 2] [--image docs/images/tuning_front.png]

Each configuration flies: ``delay.yaml`` with 0 to 120 ms more delay than modelled, for its
margin; vehicles of ``hover.yaml`` and ``lemniscate.yaml``, of which it knows the mass; those of
``configured.yaml``, of which it knows lags, delay and drag; the square and the lemniscate at
2.6 rad/s on a vehicle as modelled. Prints the table that the page has.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from markdown_table import markdown_table

from quad_mpc_ros import load_config
from quad_mpc_ros.analysis.figures import style
from quad_mpc_ros.configuration import files
from quad_mpc_ros.control.ocp.margins import stability_margins
from quad_mpc_ros.extras.campaigns.campaign_file import Overrides, campaign_from
from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers, batched

DELAYS = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12)  # s, more than modelled
CALM = 0.175  # rad: it oscillates where it tilts further in hover, long after its start

GUESSED = {"rate_time_constant": 0.07, "thrust_time_constant": 0.04, "input_delay": 0.02}
CONFIGURED = {"rate_time_constant": 0.03, "thrust_time_constant": 0.03, "input_delay": 0.02}
PLANT = {"input_delay": "command_delay"}  # where the simulator has another name for it


@dataclass(frozen=True)
class Front:
    """One configuration: a preset and its changes."""

    name: str
    preset: str
    changes: tuple[str, ...] = ()

    def delay_margin(self) -> float:
        """Return the computed delay beyond the modelled at which the hover oscillates [s]."""
        return stability_margins(load_config(self.preset, assignments=self.changes).mpc).delay


FRONT = (
    Front("default", "default"),
    Front("R / 5", "default", ("mpc.R=[0.08,0.01,0.01,0.01]",)),
    Front("R / 50", "default", ("mpc.R=[0.008,0.001,0.001,0.001]",)),
    Front("agile, R 0.1", "agile", ("mpc.R=[0.0,0.1,0.1,0.1]",)),
    Front("agile, R 0.01", "agile", ("mpc.R=[0.0,0.01,0.01,0.01]",)),
    Front("agile", "agile"),
)


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Results of one configuration: shares of crashed flights in [0, 1], lengths [m]."""

    front: Front
    margin: float
    """Most delay beyond the modelled, of those flown, that it hovers with [s]."""
    lost: float
    """Of the vehicles of which it knows the mass, on the lemniscate and in hover."""
    rmse: float
    """95th percentile over the flights on the lemniscate without a crash."""
    lost_configured: float
    rmse_configured: float
    square: float
    fast: float
    """The lemniscate at 2.6 rad/s."""

    @property
    def cells(self) -> list[str]:
        """Return its row of the table."""
        margin = "none" if self.margin < 0.0 else f"{1e3 * self.margin:.0f} ms"
        return [
            *(self.front.name, margin, f"{1e3 * self.front.delay_margin():.0f} ms"),
            *(f"{self.lost:.0%}", f"{100 * self.rmse:.1f} cm"),
            *(f"{self.lost_configured:.0%}", f"{100 * self.rmse_configured:.1f} cm"),
            *(f"{self.square:.2f} m", f"{100 * self.fast:.1f} cm"),
        ]


HEADER = (
    *("configuration", "tolerated delay", "computed", "lost, mass configured", "RMSE, p95"),
    *("lost, all configured", "RMSE, p95", "square", "lemniscate 2.6"),
)


class Flights:
    """Campaigns of one configuration after the other, on the same workers."""

    def __init__(self, workers: LocalWorkers, *, flights: int) -> None:
        self._workers = workers
        self._flights = flights

    def flown(self, front: Front) -> Flown:
        """Fly all of it."""
        print(f"{front.name} ...", file=sys.stderr, flush=True)
        hover = self._rows(front, _content("hover"))
        unknown = self._rows(front, _content("lemniscate"))
        configured = self._rows(front, _content("configured"))
        (square,) = self._rows(front, _alone("square", 16.0, GUESSED), flights=1)
        fast = _alone("lemniscate", 10.0, CONFIGURED, {"reference.angular_frequency": 2.6})
        (lemniscate,) = self._rows(front, fast | {"start": "reference"}, flights=1)
        return Flown(
            front=front,
            margin=self._margin(front),
            lost=_lost([*hover, *unknown]),
            rmse=_rmse(unknown),
            lost_configured=_lost(configured),
            rmse_configured=_rmse(configured),
            square=float(square["position_rmse_m"]),
            fast=float(lemniscate["position_rmse_m"]),
        )

    def _margin(self, front: Front) -> float:
        held = -1.0
        for delay in DELAYS:
            content = _content("delay")
            content["set"] = {f"mpc.{name}": value for name, value in GUESSED.items()}
            content["set"]["mpc.advanced.oscillation.action"] = (
                "warn"  # its weights are judged, not their rescue
            )
            content["vary"]["simulator.command_delay"]["plus"] = delay
            rows = self._rows(front, content, flights=8)
            calm = all(_flew(row) and float(row["settled_tilt_max_rad"]) < CALM for row in rows)
            if not calm:
                break
            held = delay
        return held

    def _rows(
        self, front: Front, content: Mapping[str, Any], *, flights: int | None = None
    ) -> Sequence[Mapping[str, Any]]:
        overrides = Overrides(
            config=(front.preset,), assignments=front.changes, flights=flights or self._flights
        )
        campaign = campaign_from(content, overrides, where=front.name)
        batches = batched(range(campaign.flights), workers=self._workers.workers)
        flown = itertools.chain.from_iterable(self._workers.fly(campaign, batches))
        return sorted((flight.row for flight in flown), key=lambda row: int(row["flight"]))


def _content(name: str) -> dict[str, Any]:
    text = files.shipped("campaigns")[name].read_text(encoding="utf-8")
    content: dict[str, Any] = yaml.safe_load(text)
    return content


def _alone(
    reference: str,
    duration: float,
    model: Mapping[str, float],
    given: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the campaign of one vehicle that lags as the model."""
    plant = {f"simulator.{PLANT.get(name, name)}": value for name, value in model.items()}
    modelled = {f"mpc.{name}": value for name, value in model.items()}
    return {
        "reference": reference,
        "duration": duration,
        "set": {**modelled, **plant, **(given or {})},
    }


def _flew(row: Mapping[str, Any]) -> bool:
    return not row["crashed"]


def _lost(rows: Sequence[Mapping[str, Any]]) -> float:
    return float(np.mean([not _flew(row) for row in rows]))


def _rmse(rows: Sequence[Mapping[str, Any]]) -> float:
    return float(np.quantile([float(row["position_rmse_m"]) for row in rows if _flew(row)], 0.95))


def draw(flown: Sequence[Flown], path: Path) -> None:
    """Draw the accuracy where all is configured against the margin of delay and the losses."""
    figure = style.new_figure(9.0, 3.2, dpi=130)
    accuracy = [100 * each.rmse_configured for each in flown]
    for axes, places, unit in zip(
        figure.subplots(1, 2, sharey=True),
        (
            [1e3 * max(each.margin, 0.0) for each in flown],
            [100 * each.lost for each in flown],
        ),
        ("tolerated delay beyond the model's [ms]", "crashed, only the mass configured [%]"),
        strict=True,
    ):
        axes.plot(places, accuracy, "o", color="#0072B2")
        for x, y, each in zip(places, accuracy, flown, strict=True):
            axes.annotate(
                each.front.name,
                (x, y),
                xytext=(6, -3),
                textcoords="offset points",
                fontsize=8,
                color=style.INK,
            )
        axes.set_xlabel(unit, fontsize=9, color=style.INK)
        axes.set_xlim(-0.05 * max(places), 1.3 * max(places))
        axes.set_ylim(0.0, 1.15 * max(accuracy))
        style.tidy(axes)
        axes.set_ylabel("RMSE, all configured, p95 [cm]", fontsize=9, color=style.INK)
    style.save(figure, path)


def main() -> None:
    """Fly, print the table and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=40, help="of each campaign")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--image", type=Path, default=Path("docs/images/tuning_front.png"))
    arguments = parser.parse_args()
    with LocalWorkers(arguments.workers) as workers:
        flights = Flights(workers, flights=arguments.flights)
        flown = [flights.flown(front) for front in FRONT]
    print(markdown_table(HEADER, [each.cells for each in flown]))
    draw(flown, arguments.image)


if __name__ == "__main__":
    main()
