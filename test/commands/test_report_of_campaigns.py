"""``quad_mpc report`` on campaigns, as a user runs it, and its page in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.browser import Open, headless_browser
from fixtures.campaigns import CONTENT, HereAndNow
from fixtures.html_page import data_of
from fixtures.random_campaigns import random_rows, write_campaign

from quad_mpc_ros.cli import main

COUNT = 300
ROWS = random_rows(COUNT)
OTHERS = random_rows(COUNT, worse=0.01)


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("campaigns")
    return write_campaign(folder / "mine", ROWS), write_campaign(folder / "yours", OTHERS)


def test_recognises_a_campaign_by_its_table(campaigns: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert main(["report", *map(str, campaigns), "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert "<h1>mine, yours</h1>" in text
    assert data_of(text)["pairs"]["total"] == COUNT
    assert main(["report", str(campaigns[0]), "--out", str(out)]) == 2
    assert main(["report", str(campaigns[0]), "--out", str(out), "--overwrite"]) == 0


def test_the_same_campaign_twice_has_two_names(
    campaigns: tuple[Path, Path], tmp_path: Path
) -> None:
    out = tmp_path / "page.html"
    folder = str(campaigns[0])
    assert main(["report", folder, folder, "--out", str(out)]) == 0
    assert "<h1>mine, mine_2</h1>" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["runs/one"], "given campaigns"),
        (["--csv", "series"], "flights.csv"),
        (["--png", "figures"], "flights/NUMBER.yaml"),
    ],
)
def test_unsupported_option_for_campaigns_is_one_line(
    arguments: list[str],
    message: str,
    campaigns: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "page.html"
    assert main(["report", str(campaigns[0]), *arguments, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert not out.exists()


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "flight,error,crashed,crash,crash_time_s\n1\n"]
)
def test_a_bad_table_is_one_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flights.csv").write_text(text)
    out = tmp_path / "page.html"
    assert main(["report", str(tmp_path), "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(tmp_path) in line
    assert not out.exists()


def test_a_campaign_that_was_flown_has_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("quad_mpc_ros.commands.campaign.engine_of", lambda options: HereAndNow())
    file = tmp_path / "hover.yaml"
    file.write_text(yaml.safe_dump(CONTENT))
    out = tmp_path / "flown"
    assert main(["campaign", str(file), "--out", str(out)]) == 0
    assert f"report   {out / 'report.html'}" in capsys.readouterr().out
    (points,) = data_of((out / "report.html").read_text(encoding="utf-8"))["flights"]
    assert points["flight"] == list(range(CONTENT["flights"]))
    again = points["commands"][0]
    command = f"{again['before']}{2:0{again['digits']}}{again['after']}"
    assert Path(command.split()[-1]).is_file()


@pytest.fixture(scope="module")
def open_page() -> Iterator[Open]:
    with headless_browser() as opens:
        yield opens


@pytest.fixture(scope="module")
def one(
    open_page: Open, campaigns: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> SimpleNamespace:
    path = tmp_path_factory.mktemp("one") / "page.html"
    assert main(["report", str(campaigns[0]), "--out", str(path)]) == 0
    return open_page(path)


def traces(opened: SimpleNamespace, figure: str) -> list[dict[str, Any]]:
    """Return what a figure shows: name, x and y of each trace."""
    found: list[dict[str, Any]] = opened.page.evaluate(
        "key => document.getElementById(`figure-${key}`).data"
        ".map(({name, x, y, customdata}) => ({name, x: [...x], y: [...y], customdata}))",
        figure,
    )
    return found


def check_quiet(opened: SimpleNamespace) -> None:
    assert opened.errors == []
    assert [url for url in opened.requests if not url.startswith(("data:", "blob:"))] == [
        opened.path.as_uri()
    ]


@pytest.mark.slow
class TestInABrowser:
    def test_every_choice_is_drawn_without_an_error(self, one: SimpleNamespace) -> None:
        choices = one.page.locator("select")
        for number in range(choices.count()):
            select = choices.nth(number)
            for name in select.locator("option").all_text_contents():
                select.select_option(name)
        for number in range(one.page.locator("input").count()):
            one.page.locator("input").nth(number).check()
        for number in range(one.page.locator("input").count()):
            one.page.locator("input").nth(number).uncheck()
        check_quiet(one)

    def test_the_map_shows_every_flight_where_it_was(self, one: SimpleNamespace) -> None:
        one.page.select_option("#map-x", "simulator.lag")
        one.page.select_option("#map-y", "simulator.wind.0")
        drawn = {
            flight: (trace["name"], x, y)
            for trace in traces(one, "map")
            for (flight, *_), x, y in zip(trace["customdata"], trace["x"], trace["y"], strict=True)
        }
        assert len(drawn) == COUNT
        for row in ROWS:
            name, x, y = drawn[row["flight"]]
            assert (name in ("did not crash", "error")) != row["crashed"]
            assert (x, y) == pytest.approx((row["simulator.lag"], row["simulator.wind.0"]), 1e-5)
        points = one.page.locator("#figure-map .scatterlayer path.point")
        assert points.count() == COUNT

    def test_a_figure_over_names_and_over_a_logarithm(self, one: SimpleNamespace) -> None:
        one.page.select_option("#scatter-y", "fallbacks")
        one.page.select_option("#scatter-x", "reference.trajectory")
        one.page.check("#scatter-log-y")
        zeros = sum(row.get("fallbacks") == 0 for row in ROWS)
        assert f"Of {zeros} values of 0 or less" in one.page.inner_text("#scatter-notes")
        names = sorted({row["reference.trajectory"] for row in ROWS})
        for trace in traces(one, "scatter"):
            for (flight, *_), x in zip(trace["customdata"], trace["x"], strict=True):
                assert abs(x - names.index(ROWS[flight]["reference.trajectory"])) <= 0.25
        one.page.uncheck("#scatter-log-y")

    @pytest.mark.parametrize("logarithmic", [False, True])
    def test_the_histogram_counts_every_flight(
        self, logarithmic: bool, one: SimpleNamespace
    ) -> None:
        one.page.select_option("#distribution-figure", "position_rmse_m")
        one.page.select_option("#distribution-of", "all flown")
        one.page.select_option("#distribution-as", "histogram")
        one.page.set_checked("#distribution-log", logarithmic)
        (bars,) = traces(one, "distribution")
        known = [row["position_rmse_m"] for row in ROWS if "position_rmse_m" in row]
        assert sum(bars["y"]) == len(known)
        (low, high), count = bars["customdata"][3], bars["y"][3]
        assert sum(low <= value < high for value in known) == count
        # The bars stand on the axis where their values are.
        middle = np.mean(np.log10([low, high])) if logarithmic else np.mean([low, high])
        assert bars["x"][3] == pytest.approx(float(middle))

    def test_the_worst_flights_have_their_commands(
        self, one: SimpleNamespace, campaigns: tuple[Path, Path]
    ) -> None:
        one.page.select_option("#worst-by", "duration_s")
        cells = one.page.locator("#worst-table tr").nth(1).locator("td").all_text_contents()
        worst = max(
            (row for row in ROWS if row["crashed"]), key=lambda row: float(row["duration_s"])
        )
        assert cells[0] == str(worst["flight"])
        file = campaigns[0] / "flights" / f"{worst['flight']:04d}.yaml"
        assert cells[-1] == f"quad_mpc simulate --config {file}"

    def test_a_click_on_a_point_shows_its_command(self, one: SimpleNamespace) -> None:
        one.page.evaluate(
            "(() => { const figure = document.getElementById('figure-map');"
            "const data = figure.data[0];"
            "figure.emit('plotly_click', {points: [{data, customdata: data.customdata[0]}]}); })()"
        )
        flight = traces(one, "map")[0]["customdata"][0][0]
        assert one.page.inner_text("#map-again").endswith(f"mine/flights/{flight:04d}.yaml")

    def test_two_campaigns(
        self, open_page: Open, campaigns: tuple[Path, Path], tmp_path: Path
    ) -> None:
        path = tmp_path / "page.html"
        assert main(["report", *map(str, campaigns), "--out", str(path)]) == 0
        two = open_page(path)
        two.page.select_option("#pair-figure", "position_rmse_m")
        two.page.check("#pair-log")
        line, points = traces(two, "pair")
        assert line["x"] == line["y"]
        for (flight, *_), x, y in zip(points["customdata"], points["x"], points["y"], strict=True):
            mine, yours = ROWS[flight], OTHERS[flight]
            assert not mine["crashed"]
            assert not yours["crashed"]
            assert y == pytest.approx(mine["position_rmse_m"], rel=1e-5)
            assert x == pytest.approx(yours["position_rmse_m"], rel=1e-5)
        counts = {trace["name"]: len(trace["x"]) for trace in traces(two, "map")}
        both = [(m["crashed"], y["crashed"]) for m, y in zip(ROWS, OTHERS, strict=True)]
        assert counts["only in yours"] == both.count((False, True))
        assert counts["in both"] == both.count((True, True))
        two.page.select_option("#distribution-as", "cumulative share")
        assert [each["name"] for each in traces(two, "distribution")] == ["mine", "yours"]
        check_quiet(two)

    @pytest.mark.parametrize("rows", [[], ROWS[:1]], ids=["none", "one"])
    def test_a_small_campaign(self, open_page: Open, rows: list[Any], tmp_path: Path) -> None:
        folder = write_campaign(tmp_path / "small", rows)
        assert main(["report", str(folder), "--out", str(tmp_path / "page.html")]) == 0
        check_quiet(open_page(tmp_path / "page.html"))
