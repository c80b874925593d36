"""The figure of a campaign: its order, its marks and its percentiles against the rows."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.campaigns import CONTENT, HereAndNow
from matplotlib.image import imread

from quad_mpc_ros.cli import main
from quad_mpc_ros.extras.campaigns.campaign_file import campaign_from
from quad_mpc_ros.extras.campaigns.figure import campaign_figure, strongest, write_figure

CAMPAIGN = campaign_from(
    {
        "flights": 400,
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
    row = {"flight": number, "error": "", "crash": "", **CAMPAIGN.cells(CAMPAIGN.drawn(number))}
    if number % 50 == 7:
        return {**row, "crashed": False, "error": "solver: not found"}
    crashed = row["simulator.wind.0"] > 3.0
    error = (0.01 + row["simulator.drag"] / 10.0) * random.Random(number).uniform(0.8, 1.2)
    row |= {"crashed": crashed, "crash": "away" if crashed else ""}
    return row | {"settled_error_mean_m": error, "settled_error_max_m": 2.0 * error}


ROWS = [flight(number) for number in range(400)]


def test_parameters_with_the_strongest_effect_come_first() -> None:
    random_ = np.random.default_rng(0)
    names = np.array(["a", "b"])[random_.integers(0, 2, 500)]
    columns = {
        "nothing": random_.random(500),
        "constant": np.ones(500),
        "name": names,
        "cause": random_.random(500),
    }
    error = random_.random(500) + 10.0 * columns["cause"] + 0.5 * (names == "b")
    error[columns["cause"] > 0.9] = np.inf
    error[::100] = np.nan
    assert strongest(columns, error) == ["cause", "name", "nothing"]


def test_marks_every_crashed_flight_and_the_percentiles_of_the_others() -> None:
    distribution, *effects = campaign_figure(CAMPAIGN, ROWS).axes
    flown = [row for row in ROWS if not row["error"] and not row["crashed"]]
    values = sorted(row["settled_error_mean_m"] for row in flown)
    texts = [each.get_text() for each in distribution.texts]
    for percent in (50, 95):
        value = values[math.ceil(percent * len(values) / 100) - 1]
        assert f"p{percent} {value:.3g} m" in texts
    labels = [each.get_xlabel() for each in effects]
    assert set(labels[:2]) == {"simulator.wind.0 [m/s]", "simulator.drag [1/s]"}
    assert len(labels) == 6  # the seed has no place in it
    for axes in effects:
        points, _, crosses = axes.get_lines()
        assert len(points.get_xdata()) == len(flown)
        assert len(crosses.get_xdata()) == sum(row["crashed"] for row in ROWS) > 0


@pytest.mark.parametrize(
    "rows",
    [[], ROWS[:1], ROWS[7:8], [row for row in ROWS if row["crashed"]]],
    ids=["none", "one", "an error", "all crashed"],
)
def test_draws_few_flights(rows: list[dict[str, Any]], tmp_path: Path) -> None:
    assert imread(write_figure(tmp_path, CAMPAIGN, rows)).size > 0


def test_a_campaign_that_was_flown_has_its_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("quad_mpc_ros.commands.campaign.engine_of", lambda options: HereAndNow())
    file, out = tmp_path / "hover.yaml", tmp_path / "flown"
    file.write_text(yaml.safe_dump(CONTENT))
    assert main(["campaign", str(file), "--out", str(out)]) == 0
    assert f"figure   {out / 'campaign.png'}" in capsys.readouterr().out
    assert imread(out / "campaign.png").size > 0
    assert main(["report", str(out), "--out", str(tmp_path / "page.html")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: DIR: given the campaign {out}, expected a run")
