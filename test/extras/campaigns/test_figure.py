# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The picture of a campaign: crosses and percentiles compared with the rows."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from fixtures.campaigns import CONTENT
from fixtures.engines import InThisProcess
from matplotlib.image import imread

from quad_mpc_ros.cli import main
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_from
from quad_mpc_ros.extras.campaigns.figure import campaign_figure, write_figure

CAMPAIGN = campaign_from(
    {
        "flights": 200,
        "vary": {
            "simulator.wind": {"uniform": [[-4, -4, -1], [4, 4, 1]]},
            "simulator.drag": {"uniform": [0.0, 0.6]},
            "simulator.odom_rate": {"choice": [50.0, 100.0, 200.0]},
            "reference.trajectory": {"choice": ["hover", "square"]},
            "simulator.seed": {"integers": [0, 1000000]},
        },
    }
)


def flight(number: int) -> dict[str, Any]:
    """Return a flight that crashes in strong wind and whose error grows with the drag."""
    row = {"flight": number, "crashed": False, **CAMPAIGN.cells(CAMPAIGN.drawn(number))}
    if number % 50 == 7:
        return row | {"error": "solver: not found"}
    if row["simulator.wind.0"] > 3.0:
        row |= {"crashed": True, "crash": "away"}
    error = 0.01 + row["simulator.drag"] / 10.0
    return row | {"settled_error_mean_m": error, "settled_error_max_m": 2.0 * error}


ROWS = [flight(number) for number in range(200)]
CRASHED = [row for row in ROWS if row["crashed"]]


def test_marks_every_crash_and_shows_percentiles_of_the_other_flights() -> None:
    figure = campaign_figure(CAMPAIGN, ROWS)
    distribution, *effects = figure.axes
    completed = [row for row in ROWS if not row["crashed"] and "error" not in row]
    errors = sorted(row["settled_error_mean_m"] for row in completed)
    p50, p95 = (errors[math.ceil(percent * len(errors) / 100) - 1] for percent in (50, 95))
    mean, _ = (each.get_text() for each in distribution.get_legend().get_texts())
    assert mean.startswith(f"mean, p50 {p50:.3g} m, p95 {p95:.3g} m")
    assert [axes.get_xlabel().split()[0] for axes in effects] == [
        *(f"simulator.wind.{element}" for element in range(3)),
        "simulator.drag",
        "simulator.odom_rate",
        "reference.trajectory",  # and no seed
    ]
    assert effects[3].get_xlabel() == "simulator.drag [1/s]"
    for axes in effects:
        points, medians, crosses = axes.get_lines()
        assert len(points.get_xdata()) == len(completed)
        assert len(medians.get_xdata()) > 1
        assert len(crosses.get_xdata()) == len(CRASHED) > 0
    assert list(effects[0].get_lines()[2].get_xdata()) == [
        row["simulator.wind.0"] for row in CRASHED
    ]


@pytest.mark.parametrize(
    "rows",
    [[], ROWS[:1], ROWS[7:8], CRASHED],
    ids=["none", "one", "an error", "all crashed"],
)
def test_draws_few_flights(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    write_figure(tmp_path, CAMPAIGN, rows)
    assert imread(tmp_path / "campaign.png").size > 0


def test_campaign_writes_its_figure_and_report_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("quad_mpc_ros.commands.campaign.engine_of", lambda _: InThisProcess())
    file, out = tmp_path / "hover.yaml", tmp_path / "flown"
    file.write_text(yaml.safe_dump(CONTENT))
    assert main(["campaign", str(file), "--out", str(out)]) == 0
    assert f"figure   {out / 'campaign.png'}" in capsys.readouterr().out
    assert imread(out / "campaign.png").size > 0
    assert main(["report", str(out), "--out", str(tmp_path / "page.html")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: DIR: given the campaign {out}, expected a run")
