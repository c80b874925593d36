"""``quad_mpc report`` as a user runs it, on good bags and bad ones, and its page in a browser."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.browser import headless_browser
from matplotlib.image import imread

from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.recordings.writer import BagWriter

OVER_TIME = ("error", "position", "attitude", "velocity", "inputs", "solver", "source")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        # The bags are what is wanted; the figures of each run take longer than its flight.
        patch.setattr("quad_mpc_ros.commands.simulate.finish", lambda out, wall_seconds: 0)
        for name, preset in (("manifold", "default"), ("paper", "paper")):
            out = str(folder / name)
            code = main(["simulate", "--config", preset, "--duration", "2.5", "--out", out])
            assert code == 0
    return folder / "manifold", folder / "paper"


def test_page_and_series_of_two_runs(runs: tuple[Path, Path], tmp_path: Path) -> None:
    first, second = runs
    arguments = ["report", str(first), str(second / "bag"), "--out", str(tmp_path / "two.html")]
    assert main([*arguments, "--csv", str(tmp_path / "csv")]) == 0
    text = (tmp_path / "two.html").read_text(encoding="utf-8")
    assert "<h1>manifold, paper</h1>" in text
    for name, run in (("manifold", first), ("paper", second)):
        with (tmp_path / "csv" / name / "odometry.csv").open() as table:
            heights = [float(row["p_WB_z_m"]) for row in csv.DictReader(table)]
        assert heights == Recording(run / "bag").flight().p_WB[:, 2].tolist()
    assert not list(tmp_path.rglob("*.part"))


def test_overwrites_only_with_the_option(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, precious = tmp_path / "page.html", tmp_path / "csv" / "manifold" / "ticks.csv"
    out.write_text("do not touch")
    assert main(["report", str(runs[0]), "--out", str(out)]) == 2
    assert "exists and is not overwritten" in capsys.readouterr().err
    assert out.read_text() == "do not touch"
    precious.parent.mkdir(parents=True)
    precious.write_text("nor this")
    other = str(tmp_path / "other.html")
    assert main(["report", str(runs[0]), "--out", other, "--csv", str(tmp_path / "csv")]) == 2
    assert precious.read_text() == "nor this"
    assert not Path(other).exists()
    assert main(["report", str(runs[0]), "--out", str(out), "--overwrite"]) == 0
    assert out.read_text().startswith("<!DOCTYPE html>")


def test_runs_of_the_same_name_are_numbered(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "manifold"
    shutil.copytree(runs[0] / "bag", again / "bag")
    out = tmp_path / "page.html"
    assert main(["report", str(runs[0]), str(again), "--out", str(out)]) == 0
    assert "<h1>manifold, manifold_2</h1>" in out.read_text()


def bad_bag(folder: Path, kind: str) -> Path:
    """Return something that is no bag of a flight."""
    if kind == "empty folder":
        folder.mkdir()
    elif kind == "garbage":
        folder.mkdir()
        (folder / "bag_0.mcap").write_bytes(b"this is no MCAP file")
    elif kind == "no odometry":
        with BagWriter(folder) as writer:
            writer.add_topic("/odom", "nav_msgs/msg/Odometry")
    return folder


@pytest.mark.parametrize("kind", ["missing", "empty folder", "garbage", "no odometry"])
def test_a_bad_bag_is_one_line_and_exit_code_2(
    kind: str, runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, out = bad_bag(tmp_path / "broken", kind), tmp_path / "page.html"
    assert main(["report", str(runs[0]), str(bag), "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert str(bag) in line
    assert not out.exists()


def test_reports_a_path_that_cannot_be_written(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["report", str(runs[0]), "--out", str(tmp_path / "file" / "page.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert main(["report", str(runs[0]), "--out", str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err


@pytest.fixture(scope="module")
def opened(
    runs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[SimpleNamespace]:
    """Open the page of two runs in a headless Chromium, and keep what the browser says."""
    with headless_browser() as open_page:
        path = tmp_path_factory.mktemp("page") / "page.html"
        assert main(["report", *map(str, runs), "--out", str(path)]) == 0
        found = open_page(path)
        found.page.wait_for_function(
            "document.querySelectorAll('.js-plotly-plot .main-svg').length >= 7"
        )
        yield found


@pytest.mark.slow
class TestInABrowser:
    def test_it_loads_without_an_error_and_without_the_network(
        self, opened: SimpleNamespace
    ) -> None:
        assert opened.errors == []
        assert [url for url in opened.requests if not url.startswith(("data:", "blob:"))] == [
            opened.path.as_uri()
        ]

    @pytest.mark.parametrize("figure", OVER_TIME)
    def test_curves_are_drawn(self, figure: str, opened: SimpleNamespace) -> None:
        """Each curve is a path on the screen that goes across its axes."""
        widths = opened.page.evaluate(
            "figure => [...document.querySelectorAll(`#figure-${figure} path.js-line`)]"
            ".map(path => path.getBoundingClientRect().width)",
            figure,
        )
        traces = opened.page.evaluate(
            "figure => document.getElementById(`figure-${figure}`).data.length", figure
        )
        drawn = [width for width in widths if width > 400]
        assert len(drawn) == traces >= 2

    def test_the_paths_in_space_are_shown(self, opened: SimpleNamespace) -> None:
        widths = opened.page.evaluate(
            "[...document.querySelectorAll('#path img')].map(image => image.naturalWidth)"
        )
        assert len(widths) == 2
        assert min(widths) > 1000

    def test_the_curve_is_the_flight(
        self, opened: SimpleNamespace, runs: tuple[Path, Path]
    ) -> None:
        shown = opened.page.evaluate(
            "document.getElementById('figure-position').calcdata"
            ".filter(curve => curve[0].trace.name === 'flown')"
            ".map(curve => curve.map(point => [point.x, point.y]))"
        )
        flown = [np.array(curve) for curve in shown]
        for number, run in enumerate(runs):
            flight = Recording(run / "bag").flight()
            for curve, values in zip(flown[3 * number :], flight.p_WB.T, strict=False):
                assert curve[:, 0] == pytest.approx(flight.time)
                assert curve[:, 1] == pytest.approx(values, abs=1e-6)

    def test_zoom_applies_to_all_figures(self, opened: SimpleNamespace) -> None:
        ranges = (
            "[...document.querySelectorAll('.js-plotly-plot')].filter(f => f.layout.xaxis)"
            ".flatMap(f => [f.layout.xaxis.range, f.layout.xaxis2.range])"
        )
        opened.page.evaluate("Plotly.relayout('figure-inputs', {'xaxis.range': [0.5, 1.5]})")
        opened.page.wait_for_function(f"{ranges}.every(r => r[0] === 0.5 && r[1] === 1.5)")
        opened.page.evaluate("Plotly.relayout('figure-error', {'xaxis.autorange': true})")
        opened.page.wait_for_function(f"{ranges}.every(r => r[1] > 2)")
        assert opened.errors == []

    def test_figures_are_saved(self, opened: SimpleNamespace) -> None:
        with opened.page.expect_download() as download:
            opened.page.hover("#figure-error")
            opened.page.click("#figure-error .modebar-btn[data-title*='ownload']")
        assert download.value.suggested_filename == "error.png"
        assert imread(download.value.path(), format="png").size > 0
