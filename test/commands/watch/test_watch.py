"""``quad_mpc watch`` of flights and bags, with a terminal and without."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.pseudo_terminal import PseudoTerminal

from quad_mpc_ros.cli import main

WATCH = [sys.executable, "-m", "quad_mpc_ros.cli", "watch"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a second of flight."""
    out = tmp_path_factory.mktemp("flight")
    options = ["--duration", "3", "--out", str(out), "--set", "reference.trajectory=circle"]
    assert main(["simulate", *options]) == 0
    return out / "bag"


def test_the_end_of_a_bag_is_shown_once(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--bag", str(bag), "--once"]) == 0
    shown = capsys.readouterr().out
    assert f"{bag}, 3.0 s" in shown.replace("\n", "")
    assert "commands  mpc" in shown
    assert "50 Hz" in shown
    assert "\x1b" not in shown
    assert "●" in shown


def test_the_folder_of_a_run_is_shown(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--bag", str(bag.parent), "--once"]) == 0
    assert "commands  mpc" in capsys.readouterr().out


def test_a_bag_is_played_at_a_rate(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    began = time.monotonic()
    options = ["--bag", str(bag), "--rate", "10", "--interval", "0.1"]
    assert main(["watch", *options]) == 0
    assert time.monotonic() - began > 0.2  # three seconds, ten times as fast
    titles = [line for line in capsys.readouterr().out.splitlines() if line.startswith("╭")]
    assert [title.rpartition(", ")[2].split()[0] for title in titles] == [
        "0.0",
        "1.0",
        "2.0",
        "3.0",
    ]


def test_in_a_terminal_it_draws_over_itself_and_ends_with_ctrl_c(bag: Path) -> None:
    terminal = PseudoTerminal([*WATCH, "--bag", str(bag), "--rate", "0.1"])
    try:
        wait_for(lambda: "\x1b[?1049h" in terminal.shown and "thrust" in terminal.shown)
        terminal.type("\x03")
        assert terminal.process.wait(20) == 0, terminal.shown
        wait_for(lambda: "\x1b[?1049l" in terminal.shown)  # the screen as it was
        assert "\x1b[?25h" in terminal.shown  # and the cursor
        assert "Traceback" not in terminal.shown
    finally:
        terminal.process.kill()
        terminal.close()


def wait_for(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--rate", "2"], "--rate is of a bag"),
        (["--interval", "0"], "--interval: given 0"),
        (["--bag", "nowhere"], "nowhere: does not exist"),
    ],
)
def test_bad_input_is_one_line(
    options: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", *options]) == 2
    assert capsys.readouterr().err.startswith(f"error: {complaint}")


def test_without_rich_it_says_what_to_install(
    bag: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rich", None)
    assert main(["watch", "--bag", str(bag)]) == 2
    assert "pip install rich" in capsys.readouterr().err


def test_a_bag_of_other_vehicles_has_nothing_to_show(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", "--bag", str(bag), "--namespace", "uav7"]) == 2
    assert "no vehicle in it" in capsys.readouterr().err
