# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc plan``, and flights with its plans."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest
import yaml
from fixtures.courses import COURSE

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands import EXIT_INTERRUPTED
from quad_mpc_ros.extras.racing.planning import race_plan
from quad_mpc_ros.extras.racing.planning.transcription import solve
from quad_mpc_ros.extras.racing.verdict import flown_course
from quad_mpc_ros.recordings.recording import Recording

pytest.importorskip("casadi")

VEHICLE = ["--config", "vehicles/cpc"]
QUICK = ["--step", "0.08"]


@pytest.fixture
def course(tmp_path: Path) -> Path:
    file = tmp_path / "course.yaml"
    file.write_text(yaml.safe_dump(COURSE))
    return file


def test_plan_is_written_drawn_checked_and_flown(
    course: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "race.csv"
    assert main(["plan", str(course), *VEHICLE, *QUICK, "--out", str(out)]) == 0
    output = capsys.readouterr().out
    assert "gate 2" in output and "within the limits" in output
    assert matplotlib.image.imread(out.with_suffix(".png")).std() > 0.01
    assert sorted(path.name for path in tmp_path.glob("race*")) == ["race.csv", "race.png"]

    flown = ["--gates", str(course), "--set", f"reference.file={out}"]
    margin = ["--set", "reference.limit_margin=0.05"]
    check = ["check-reference", *VEHICLE, *flown, *margin, "--out", str(tmp_path / "check")]
    assert main(check) == 0
    run = tmp_path / "run"
    assert main(["simulate", *VEHICLE, *flown, "--duration", "4", "--out", str(run)]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert [gate["passed"] for gate in summary["gates"]] == [True, True]
    assert set(summary["gates"][0]) == {"gate", "time_s", "miss_m", "passed", "clipped"}
    assert 1.0 < summary["lap_time_s"] < 4.0
    assert "2 of 2 passed" in capsys.readouterr().out

    course.unlink()  # the bag has the course itself
    recorded = flown_course(Recording(run / "bag").flight())
    assert recorded is not None and recorded.numbers == (1, 2)


def test_ctrl_c_ends_the_search_without_output_files(
    course: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: Any, name: str, **options: Any) -> Any:
        if name == "vehicle":
            threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT]).start()
            options["most_iterations"] = 1_000_000  # the search does not end by itself
        return solve(*arguments, name=name, **options)

    monkeypatch.setattr(race_plan, "solve", interrupted)
    given = ["plan", str(course), *VEHICLE, "--step", "0.005", "--out", str(tmp_path / "race.csv")]
    assert main(given) == EXIT_INTERRUPTED
    assert list(tmp_path.iterdir()) == [course]


@pytest.mark.parametrize(
    ("changes", "options", "reason"),
    [
        ({"gates": COURSE["gates"][:1]}, [], "given 1, expected 2 to 100 passages"),
        ({"start": [0.0, float("nan"), 1.0]}, [], "start: given [0.0, nan, 1.0], expected 3"),
        ({}, ["--gate-margin", "0.3"], "gates[2]: unreachable"),
        ({}, ["--set", "reference.limit_margin=0.99"], "reference.limit_margin: given 0.99"),
        ({}, ["--out", "/dev/null/race.csv"], "--out: /dev/null/race.csv cannot be written"),
    ],
)
def test_rejects_bad_input_in_one_line(
    changes: dict[str, object],
    options: list[str],
    reason: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "course.yaml"
    file.write_text(yaml.safe_dump({**COURSE, **changes}))
    out = [] if "--out" in options else ["--out", str(tmp_path / "race.csv")]
    assert main(["plan", str(file), *VEHICLE, *out, *options]) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "race.csv").exists()
