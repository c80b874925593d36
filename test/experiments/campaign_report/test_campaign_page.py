"""The page of campaigns without a browser: its numbers against the rows that were written."""

from __future__ import annotations

import math
import shlex
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.html_page import Elements, Rows, data_of
from fixtures.random_campaigns import FIGURES, VARIED, Row, random_rows, write_campaign

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.experiments.campaign_report import (
    ReportedCampaign,
    campaign_page,
    read_campaigns,
    write_campaign_page,
)
from quad_mpc_ros.experiments.campaign_report import campaign_tables as tables
from quad_mpc_ros.experiments.campaign_report.crash_shares import CrashShares, crash_shares
from quad_mpc_ros.experiments.campaign_report.distributions import distributions
from quad_mpc_ros.experiments.campaign_report.pairs import paired
from quad_mpc_ros.experiments.campaign_report.points import (
    MOST_POINTS,
    MOST_WORST,
    evenly_chosen,
    flight_points,
    worst_flights,
)
from quad_mpc_ros.experiments.campaign_report.proportion import Proportion
from quad_mpc_ros.experiments.campaign_report.shares_figure import shares_figure
from quad_mpc_ros.experiments.campaigns.results import results_text

COUNT = 700
ROWS = random_rows(COUNT)
FLOWN = [row for row in ROWS if not row["error"]]
UNHARMED = [row for row in FLOWN if not row["crashed"]]
CRASHED = [row for row in FLOWN if row["crashed"]]


def read(folder: Path, name: str = "mine") -> ReportedCampaign:
    (campaign,) = read_campaigns({name: folder})
    return campaign


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> ReportedCampaign:
    return read(write_campaign(tmp_path_factory.mktemp("campaign"), ROWS))


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> ReportedCampaign:
    """Return the same vehicles flown worse, but one that differs and fifty that are not there."""
    rows = random_rows(COUNT, worse=0.01)[:-50]
    rows[7]["simulator.lag"] += 1e-9
    return read(write_campaign(tmp_path_factory.mktemp("second"), rows), "yours")


def values(rows: list[Row], name: str) -> list[float]:
    return sorted(row[name] for row in rows if row.get(name) is not None)


def test_the_flights_are_counted(campaign: ReportedCampaign) -> None:
    message = tables.verdict(campaign)
    kinds = Counter(row["crash"] for row in CRASHED)
    assert f"{COUNT} flights. {COUNT - len(FLOWN)} raised an error." in message
    assert f"{len(CRASHED)} of {len(FLOWN)}, {100 * len(CRASHED) / len(FLOWN):.0f} %" in message
    assert f"{kinds['ground']} hit the ground, {kinds['upside_down']} turned over" in message
    rows = Rows(tables.flights_table([campaign])).rows
    assert rows["flew away"] == [str(kinds["away"])]
    assert rows["did not crash"] == [str(len(UNHARMED))]


@pytest.mark.parametrize(
    ("population", "rows"), [("did not crash", UNHARMED), ("all flown", FLOWN)]
)
def test_percentiles_are_those_of_the_terminal_and_measured(
    population: str, rows: list[Row], campaign: ReportedCampaign, tmp_path: Path
) -> None:
    table = Rows(tables.percentile_table([campaign], population)).rows
    for name in FIGURES:
        known = values(rows, name)
        # The least value that so many percent of all do not exceed.
        ranks = [1, *(math.ceil(percent * len(known) / 100) for percent in (50, 95, 99, 100))]
        wanted = [known[rank - 1] for rank in ranks]
        assert list(map(float, table[name])) == pytest.approx(wanted, rel=1e-3)
    if population == "did not crash":
        flown = SimpleNamespace(flights=COUNT)
        lines = results_text(tmp_path, flown, ROWS).splitlines()
        (line,) = [line for line in lines if line.startswith("position_rmse_m")]
        shown = list(map(float, table["position_rmse_m"]))[1:]
        assert list(map(float, line.split()[1:])) == pytest.approx(shown, rel=1e-2)


def test_interval_of_a_share_has_its_coverage() -> None:
    """At its ends the share seen is 1.96 standard deviations off, which is what defines it."""
    for count, total in ((0, 12), (3, 20), (10, 10), (250, 1000)):
        one = Proportion(count=count, total=total)
        low, high = one.interval
        assert low <= one.share <= high
        for end in (low, high):
            if 0.0 < end < 1.0:
                deviation = math.sqrt(end * (1.0 - end) / total)
                assert abs(one.share - end) / deviation == pytest.approx(1.96, abs=1e-3)
    # Newcombe, Statistics in Medicine 17 (1998), table I.
    low, high = Proportion(count=81, total=263).interval
    assert (low, high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert Proportion(count=0, total=0).interval == (0.0, 1.0)


def test_the_shares_are_those_of_the_rows(campaign: ReportedCampaign) -> None:
    shares = {each.name: each for each in crash_shares([campaign])}
    assert set(shares) == set(VARIED)
    for name in ("reference.trajectory", "mpc.horizon_steps"):
        flown = Counter(str(row[name]) for row in FLOWN)
        crashed = Counter(str(row[name]) for row in CRASHED)
        found = dict(zip(shares[name].labels, shares[name].proportions[0], strict=True))
        assert {label: each.total for label, each in found.items()} == flown
        assert {label: each.count for label, each in found.items()} == crashed
    lag = shares["simulator.lag"]
    totals = [each.total for each in lag.proportions[0]]
    assert len(totals) == 10
    # Equally many, but for those that stand at an edge and what does not divide.
    assert max(totals) - min(totals) <= 2
    assert sum(totals) == len(FLOWN)
    for bin_, each in enumerate(lag.proportions[0]):
        low, high = lag.edges[bin_], lag.edges[bin_ + 1]
        inside = [row for row in CRASHED if low <= row["simulator.lag"] < high]
        last = (
            bin_ == len(totals) - 1 and CRASHED and max(values(CRASHED, "simulator.lag")) == high
        )
        assert each.count == len(inside) + bool(last)


def test_parameters_with_most_uneven_crash_shares_come_first(campaign: ReportedCampaign) -> None:
    first, *rest = crash_shares([campaign])
    assert first.name == "simulator.lag"
    assert first.unevenness > 5.0
    assert all(each.unevenness < 3.0 for each in rest)


def test_bars_have_the_height_and_the_interval_of_their_share(
    campaign: ReportedCampaign, second: ReportedCampaign
) -> None:
    shares = crash_shares([campaign, second])
    figure = shares_figure(shares, ["mine", "yours"])
    for number, bars in enumerate(figure.data):
        proportions = shares[number // 2].proportions[number % 2]
        known = [each for each in proportions if each.total]
        assert np.array(bars.y)[[bool(each.total) for each in proportions]] == pytest.approx(
            [each.count / each.total for each in known]
        )
        for place, each in enumerate(proportions):
            if each.total:
                top = bars.y[place] + bars.error_y.array[place]
                assert top == pytest.approx(each.interval[1])
    # No bar hides another: beside each other, each within its place.
    left, right = figure.data[0], figure.data[1]
    assert np.array(right.x) - np.array(left.x) == pytest.approx(left.width)


def test_rare_names_share_one_bar(tmp_path: Path) -> None:
    rows = random_rows(60)
    for number, row in enumerate(rows):
        row["reference.trajectory"] = f"name_{number % 30}" if number < 50 else "name_0"
    shares = crash_shares([read(write_campaign(tmp_path, rows))])
    (names,) = (each for each in shares if each.name == "reference.trajectory")
    assert len(names.labels) == 12
    assert names.labels[-1] == "others"
    flown = sum(not row["error"] for row in rows)
    assert sum(each.total for each in names.proportions[0]) == flown


def test_distributions_are_of_all_flights(campaign: ReportedCampaign) -> None:
    found = distributions([campaign])
    assert set(found) == set(FIGURES)
    for name in FIGURES:
        for population, rows in (("did not crash", UNHARMED), ("all flown", FLOWN)):
            known = values(rows, name)
            one = found[name][population]
            assert sum(one["linear"]["counts"][0]) == len(known)
            positive = [value for value in known if value > 0]
            assert sum(one["log"]["counts"][0]) == len(positive)
            (curve,) = one["cumulative"]
            for x, y in zip(curve["x"][::20], curve["y"][::20], strict=True):
                # y of the flights have at most x, and fewer have less than it.
                assert sum(value <= x for value in known) >= y * len(known) - 1e-6
                assert sum(value < x for value in known) < y * len(known) + 1e-6
            assert (curve["x"][-1], curve["y"][-1]) == (known[-1], 1.0)
    edges = np.array(found["position_rmse_m"]["all flown"]["log"]["edges"])
    assert edges[1:] / edges[:-1] == pytest.approx(edges[1] / edges[0], rel=1e-6)


def test_crashed_flights_are_drawn_first_and_the_rest_evenly() -> None:
    crashed = np.zeros(20_000, dtype=np.bool_)
    crashed[100:1100] = True
    rows = evenly_chosen(crashed, 5000)
    assert len(rows) == 5000
    assert np.all(np.diff(rows) > 0)
    assert np.sum(crashed[rows]) == 1000
    rest = np.searchsorted(np.flatnonzero(~crashed), rows[~crashed[rows]])
    assert set(np.diff(rest)) == {4, 5}
    many = evenly_chosen(~crashed, 500)
    assert len(many) == 500
    assert not crashed[many].any()
    assert evenly_chosen(crashed[:30], 50).tolist() == list(range(30))


def test_points_are_the_flights(campaign: ReportedCampaign) -> None:
    points = flight_points(campaign, most=MOST_POINTS)
    names = [points["groups"][group]["name"] for group in points["group"]]
    assert names[: len(ROWS)] == [
        {
            "ground": "hit the ground",
            "upside_down": "turned over",
            "away": "flew away",
        }.get(row["crash"], "error" if row["error"] else "did not crash")
        for row in ROWS
    ]
    for name in (*VARIED, *FIGURES):
        for row, value in zip(ROWS, points["columns"][name], strict=True):
            wanted = row.get(name)
            assert value == (
                wanted if isinstance(wanted, str) else pytest.approx(wanted, rel=1e-5)
            )


def test_the_worst_flights_are_the_crashed_and_then_the_greatest(
    campaign: ReportedCampaign,
) -> None:
    found = worst_flights(campaign, "position_rmse_m")
    wanted = [
        row["flight"]
        for rows in (CRASHED, UNHARMED)
        for row in sorted(rows, key=lambda row: -row["position_rmse_m"])[:MOST_WORST]
    ]
    assert [flight for flight, *_ in found] == wanted
    for flight, crash, time, value in found:
        row = ROWS[flight]
        assert crash == row["crash"]
        known = [row["crash_time_s"], row["position_rmse_m"]]
        assert [time, value] == [None if x is None else pytest.approx(x, rel=1e-5) for x in known]
    lowest = min(UNHARMED, key=lambda row: row["altitude_min_m"])
    assert worst_flights(campaign, "altitude_min_m")[MOST_WORST][0] == lowest["flight"]


def test_errors_are_listed_with_how_to_see_the_first(campaign: ReportedCampaign) -> None:
    numbers = [row["flight"] for row in ROWS if row["error"]]
    ((_, *_, nothing),) = Rows(tables.error_table(campaign)).rows.values()
    assert nothing == "–"
    path = campaign.folder / "flights" / f"{numbers[0]:04d}.yaml"
    path.parent.mkdir()
    path.touch()
    ((listed, (count, text, command)),) = list(Rows(tables.error_table(campaign)).rows.items())
    assert (count, text) == (str(len(numbers)), "solver: <not> found")
    assert listed.removesuffix(", …").split(", ") == [str(number) for number in numbers[:10]]
    assert command.endswith(f"flights/{numbers[0]:04d}.yaml")


@pytest.mark.parametrize(
    ("flights", "file"), [("10", "0007.yaml"), ("100001", "000007.yaml"), ("x: [", "0007.yaml")]
)
def test_the_command_of_a_flight_names_its_file(flights: str, file: str, tmp_path: Path) -> None:
    folder = tmp_path / "it's 0000 mine"
    found = read(write_campaign(folder, random_rows(9), f"flights: {flights}\n"))
    command = shlex.split(found.command(7))
    assert command == ["quad_mpc", "simulate", "--config", str(folder / "flights" / file)]


def test_flights_of_the_same_vehicle_are_paired(
    campaign: ReportedCampaign, second: ReportedCampaign
) -> None:
    pairs = paired(campaign, second)
    others = random_rows(COUNT, worse=0.01)
    numbers = [number for number in range(COUNT - 50) if number != 7]
    assert pairs.first.table.columns["flight"][pairs.first_rows].tolist() == numbers
    flown = [n for n in numbers if not ROWS[n]["error"]]
    both = [(ROWS[n], others[n]) for n in flown]
    wanted = Counter((mine["crashed"], yours["crashed"]) for mine, yours in both)
    assert pairs.counts == {
        "neither": wanted[False, False],
        "both": wanted[True, True],
        "first": wanted[True, False],
        "second": wanted[False, True],
        "error": len(numbers) - len(flown),
    }
    assert wanted[False, True] > 10 > wanted[True, False]
    rows = Rows(tables.outcome_table(pairs)).rows
    assert rows["crashed only in yours"][0].startswith(f"{wanted[False, True]} of {len(flown)},")
    unharmed = [pair for pair in both if not pair[0]["crashed"] and not pair[1]["crashed"]]
    for difference in pairs.differences:
        name = difference.name
        known = [
            (mine[name], yours[name])
            for mine, yours in unharmed
            if mine[name] is not None and yours[name] is not None
        ]
        assert difference.count == len(known)
        assert difference.smaller.count == sum(yours < mine for mine, yours in known)
        assert difference.smaller.total == sum(yours != mine for mine, yours in known)
        middle = sorted(yours - mine for mine, yours in known)
        assert middle[(len(known) - 1) // 2] <= difference.median_difference
        assert difference.median_difference <= middle[len(known) // 2]


def test_page_states_matching_flights_and_differences(
    tmp_path: Path, campaign: ReportedCampaign, second: ReportedCampaign
) -> None:
    folder = write_campaign(tmp_path / "other", random_rows(20, seed=9), "seed: 2\nmpc: {R: 3}\n")
    message = tables.pair_sentence(paired(campaign, second))
    assert message.startswith("649 flights of 700 of mine and 650 of yours are the same vehicle")
    text = campaign_page([campaign, read(folder, "other")])
    assert "No flight is the same vehicle in both" in text
    assert data_of(text)["pairs"] is None
    rows = Rows(text).rows
    assert rows["seed"] == ["–", "2"]
    assert rows["mpc.R"] == ["–", "3"]


def test_nothing_is_paired_of_campaigns_that_vary_different_parameters(tmp_path: Path) -> None:
    rows = random_rows(5)
    mine = read(write_campaign(tmp_path / "mine", rows))
    (tmp_path / "other").mkdir()
    table = (tmp_path / "mine" / "flights.csv").read_text()
    for name in VARIED:
        table = table.replace(name, f"other.{name}")
    (tmp_path / "other" / "flights.csv").write_text(table)
    pairs = paired(mine, read(tmp_path / "other", "other"))
    assert len(pairs) == 0
    assert "vary no parameter in common" in tables.pair_sentence(pairs)


def test_the_page_loads_nothing_and_escapes_what_was_given(tmp_path: Path) -> None:
    evil = "</script><i>evil</i>"
    rows = random_rows(40)
    rows[3] |= {"error": evil, "crashed": False, "crash": ""}
    rows[4] |= {"reference.trajectory": evil}
    rows[5] |= {"crashed": True, "crash": evil, "error": ""}
    found = read(write_campaign(tmp_path, rows, evil), evil)
    for campaigns in ([found], [found, found]):
        elements = Elements(campaign_page(campaigns))
        assert all(address.startswith(("#", "data:")) for address in elements.addresses)
        tags = [tag for tag, _ in elements.elements]
        assert not {"i", "img", "iframe", "object"} & set(tags)
    assert data_of(campaign_page([found]))["flights"][0]["columns"]["reference.trajectory"][4]


def test_a_large_campaign_is_a_page_of_bounded_size(tmp_path: Path) -> None:
    rows = random_rows(6000)
    text = campaign_page([read(write_campaign(tmp_path, rows))])
    data = data_of(text)
    (points,) = data["flights"]
    assert len(points["flight"]) == MOST_POINTS
    assert points["total"] == 6000
    crashed = {row["flight"] for row in rows if row["crashed"]}
    assert crashed <= set(points["flight"])
    found = data["distributions"]["duration_s"]["all flown"]["linear"]
    assert sum(found["counts"][0]) == sum(not row["error"] for row in rows)


def degenerate(kind: str) -> list[Row]:
    rows = random_rows(30)
    if kind == "none crashed":
        return [{**row, "crashed": False, "crash": "", "crash_time_s": None} for row in rows]
    if kind == "all crashed":
        return [{**row, "error": "", "crashed": True, "crash": "ground"} for row in rows]
    if kind == "all errors":
        names = ("flight", *VARIED)
        return [
            {name: row[name] for name in names} | {"error": "no", "crashed": 0} for row in rows
        ]
    return rows[: {"none": 0, "one": 1}[kind]]


@pytest.mark.parametrize("kind", ["none", "one", "none crashed", "all crashed", "all errors"])
def test_a_campaign_of_one_kind_has_a_page(kind: str, tmp_path: Path) -> None:
    found = read(write_campaign(tmp_path, degenerate(kind)))
    text = campaign_page([found, found])
    assert f"{len(found.table)} flight" in text
    assert ("No flight crashed." in text) == (kind != "all crashed")
    assert ('id="scatter"' in text) == (kind not in ("none", "all errors"))


def test_a_campaign_that_varies_nothing_has_a_page(tmp_path: Path) -> None:
    (tmp_path / "flights.csv").write_text(
        "flight,error,crashed,crash,crash_time_s,position_rmse_m\n0,,1,ground,2.5,1.5\n"
    )
    text = campaign_page([read(tmp_path)])
    assert "1 of 1" in text
    assert 'id="map-x"' not in text
    assert "It is not there." in text


def test_parameter_with_one_value_has_no_unevenness() -> None:
    shares = CrashShares(
        name="x",
        labels=("1",),
        edges=np.zeros(0),
        proportions=((Proportion(count=1, total=2),),),
    )
    assert shares.unevenness == 0.0


def test_page_is_written_if_plotly_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_campaign(tmp_path / "mine", random_rows(10))
    path = write_campaign_page(folder)
    assert path == folder / "report.html"
    assert path is not None
    assert "<h1>mine</h1>" in path.read_text(encoding="utf-8")
    path.unlink()
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert write_campaign_page(folder) is None
    assert not path.exists()
    with pytest.raises(UserError, match=r"pip install 'quad_mpc_ros\[report\]'"):
        campaign_page([read(folder)])
