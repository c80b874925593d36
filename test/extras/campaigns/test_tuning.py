# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Studies whose flights are formulas, so that the front is known."""

from __future__ import annotations

import csv
import dataclasses
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("optuna")

from fixtures.engines import FormulaEngine

from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.extras.campaigns.campaign import Campaign
from quad_mpc_ros.extras.campaigns.tuning.objectives import (
    FLOWN,
    GIVEN_UP,
    REFUSED,
    Objective,
    Trial,
    chosen,
    front_of,
)
from quad_mpc_ros.extras.campaigns.tuning.study import Study, fly_trial
from quad_mpc_ros.extras.campaigns.tuning.tune_file import read_tuning
from quad_mpc_ros.extras.campaigns.tuning.tune_results import (
    begin,
    results_text,
    tuning_of,
    write_results,
)

SIMPLE = """
seed: 3
trials: {trials}
give_up: {give_up}
search:
  mpc.terminal_weight: {{uniform: [0.0, 4.0]}}
campaigns:
  many: {{flights: 40, reference: hover, duration: 1.0, set: {{mpc.terminal_weight: 3.5}}}}
objectives:
  - {{campaign: many, figure: settled_error_mean_m, of: mean}}
  - {{campaign: many, figure: position_rmse_m, of: max}}
"""


def study_in(folder: Path, text: str) -> Study:
    (folder / "file.yaml").write_text(text)
    tuning = read_tuning(folder / "file.yaml")
    begin(tuning, folder)
    return Study(folder, tuning)


def simple(folder: Path, *, trials: int = 25, give_up: float = 1.0) -> Study:
    return study_in(folder, SIMPLE.format(trials=trials, give_up=give_up))


def two_parabolas(campaign: Campaign, number: int) -> dict[str, Any]:
    """Schaffer's problem: the front is 0 <= w <= 2, where √f1 + √f2 = 2."""
    weight = campaign.base["mpc"].flattened()["terminal_weight"]
    return {"settled_error_mean_m": weight**2, "position_rmse_m": (weight - 2.0) ** 2}


def test_finds_the_front_of_schaffers_problem(tmp_path: Path) -> None:
    study = simple(tmp_path)
    study.run(FormulaEngine(two_parabolas))
    trials = study.trials()
    assert len(trials) == 25
    assert [trial.number for trial in trials] == list(range(25))

    front = front_of(trials)
    assert len(front) >= 8
    on_front = {trial.number for trial in front}
    weights = [trial.values["mpc.terminal_weight"] for trial in trials]
    for trial, weight in zip(trials, weights, strict=True):
        if weight <= 2.0:
            assert trial.number in on_front
            assert np.sqrt(trial.objectives).sum() == pytest.approx(2.0)
        else:  # as far from 2 on the other side is better
            bettered = any(4.0 - weight <= other < weight for other in weights)
            assert (trial.number in on_front) != bettered


def test_first_trial_is_the_configuration_of_the_campaigns(tmp_path: Path) -> None:
    study = simple(tmp_path, trials=2)
    study.run(FormulaEngine(two_parabolas))
    first = study.trials()[0]
    assert first.values == {"mpc.terminal_weight": 3.5}
    assert first.objectives == (5.0, 2.25)  # 3.5² counts as much as a lost flight


def test_searches_from_a_start_outside_the_space(tmp_path: Path) -> None:
    text = SIMPLE.format(trials=22, give_up=1.0).replace("weight: 3.5", "weight: 30.0")
    study = study_in(tmp_path, text)
    study.run(FormulaEngine(two_parabolas))
    first, *others = study.trials()
    assert first.values == {"mpc.terminal_weight": 30.0}
    assert len(others) == 21
    # The optimiser still models the parameter: later trials are nearer to the front than at first.
    weights = [trial.values["mpc.terminal_weight"] for trial in others]
    assert np.mean([weight < 2.0 for weight in weights[-8:]]) > 0.7


def test_lost_flight_never_improves_an_objective() -> None:
    random = np.random.default_rng(0)
    for of in ("mean", "median", "p95", "p99", "max"):
        objective = Objective(campaign="a", figure="f", of=of, lost=5.0, tolerance=0.0)
        for _ in range(50):
            values = random.exponential(4.0, 30)
            rows = [{"crashed": False, "f": float(value)} for value in values]
            before = objective.value(rows)
            hit = int(random.integers(30))
            for lost in (
                {"crashed": True, "f": 0.0},
                {"crashed": False, "error": "x", "f": 0.0},
                {"crashed": False, "f": None},
            ):
                assert objective.value([*rows[:hit], lost, *rows[hit + 1 :]]) >= before


def crashes(share: float) -> Any:
    """Return a formula by which so many flights crash, spread evenly."""
    return lambda campaign, number: {"crashed": (number * 7919) % 40 < 40 * share}


@pytest.mark.parametrize("share", [0.0, 0.1, 0.25, 0.275, 0.5, 1.0])
@pytest.mark.parametrize("workers", [1, 2, 7, 50])
def test_gives_up_trials_that_lose_too_many(share: float, workers: int, tmp_path: Path) -> None:
    """And the same flights count, however many workers there are."""
    (tmp_path / "file.yaml").write_text(SIMPLE.format(trials=1, give_up=0.25))
    campaigns = read_tuning(tmp_path / "file.yaml").campaigns
    engine = FormulaEngine(crashes(share), workers=workers)
    rows, given_up = fly_trial(campaigns, engine, give_up=0.25)
    assert given_up == (share > 0.25)
    alone = FormulaEngine(crashes(share), workers=1)
    assert fly_trial(campaigns, alone, give_up=0.25) == (rows, given_up)
    if share == 1.0:
        assert [row["crashed"] for row in rows["many"]] == [True] * 16


def test_given_up_trial_flies_no_other_campaign_and_is_on_no_front(tmp_path: Path) -> None:
    text = SIMPLE.format(trials=12, give_up=0.25).replace(
        "objectives:",
        "  other: {flights: 3, reference: hover, duration: 1.0, set: {mpc.terminal_weight: 3.5}}\n"
        "objectives:\n  - {campaign: other, figure: crashed, of: mean}",
    )

    def formula(campaign: Campaign, number: int) -> dict[str, Any]:
        weight = campaign.base["mpc"].flattened()["terminal_weight"]
        return {**two_parabolas(campaign, number), "crashed": weight < 1.5}

    study = study_in(tmp_path, text)
    study.run(FormulaEngine(formula))
    trials = study.trials()
    bad = [trial for trial in trials if trial.values["mpc.terminal_weight"] < 1.5]
    assert bad
    for trial in bad:
        assert trial.outcome == GIVEN_UP
        assert trial.objectives == (1.0, 5.0, 5.0)
    assert {trial.outcome for trial in front_of(trials)} == {FLOWN}


def test_first_trial_is_flown_to_the_end(tmp_path: Path) -> None:
    study = simple(tmp_path, trials=1, give_up=0.0)
    study.run(FormulaEngine(crashes(1.0)))
    (trial,) = study.trials()
    assert (trial.outcome, trial.flights, trial.lost) == (FLOWN, 40, 40)


def test_refused_configuration_is_a_trial_with_its_reason(tmp_path: Path) -> None:
    text = SIMPLE.format(trials=12, give_up=1.0).replace(
        "search:", "search:\n  mpc.throttle_max: {uniform: [0.2, 1.0]}"
    )
    study = study_in(tmp_path, text)
    study.run(FormulaEngine(two_parabolas))
    refused = [trial for trial in study.trials() if trial.outcome == REFUSED]
    assert refused
    for trial in refused:
        assert trial.values["mpc.throttle_max"] < 0.2924
        assert "mpc.throttle_max" in trial.reason
        assert trial.objectives == ()
    assert len(study.trials()) == 12
    write_results(tmp_path, tuning_of(tmp_path), study.trials())
    with (tmp_path / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["outcome"] == REFUSED for row in rows) == len(refused)


def test_figure_that_no_flight_has_is_refused(tmp_path: Path) -> None:
    study = simple(tmp_path, trials=2)
    with pytest.raises(UserError, match="settled_error_mean_m: no flight of many has this figure"):
        study.run(FormulaEngine(lambda campaign, number: {"position_rmse_m": 1.0}))


def outcomes_of(trials: Sequence[Trial]) -> list[Any]:
    """Return what does not depend on the clock."""
    return [dataclasses.replace(trial, seconds=0.0) for trial in trials]


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {fixtures!r})
from fixtures.engines import FormulaEngine
from quad_mpc_ros.extras.campaigns.tuning.study import Study
from quad_mpc_ros.extras.campaigns.tuning.tune_results import tuning_of

flights = 0

def formula(campaign, number):
    global flights
    flights += 1
    if flights == 12 * 40 + 17:
        os.kill(os.getpid(), signal.SIGKILL)
    weight = campaign.base["mpc"].flattened()["terminal_weight"]
    return {{"settled_error_mean_m": weight**2, "position_rmse_m": (weight - 2.0) ** 2}}

folder = Path({folder!r})
Study(folder, tuning_of(folder)).run(FormulaEngine(formula))
"""


def test_killed_study_resumes_with_the_same_trials(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    study = simple(whole, trials=14)
    study.run(FormulaEngine(two_parabolas))

    simple(killed, trials=14)
    program = KILLED.format(fixtures=str(Path(__file__).parents[2]), folder=str(killed))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()

    resumed = Study(killed, tuning_of(killed))
    assert len(resumed.trials()) == 12
    engine = FormulaEngine(two_parabolas)
    resumed.run(engine)
    assert engine.flown == 2 * 40
    assert outcomes_of(resumed.trials()) == outcomes_of(study.trials())


def test_folder_whose_file_has_changed_is_refused(tmp_path: Path) -> None:
    simple(tmp_path)
    path = tmp_path / "tune.yaml"
    path.write_text(path.read_text().replace("trials: 25", "trials: 30"))
    Study(tmp_path, tuning_of(tmp_path))
    path.write_text(path.read_text().replace("flights: 40", "flights: 41"))
    with pytest.raises(UserError, match=r"its tune\.yaml has changed"):
        Study(tmp_path, tuning_of(tmp_path))


def test_study_opens_in_optuna(tmp_path: Path) -> None:
    import optuna

    study = simple(tmp_path, trials=5)
    study.run(FormulaEngine(two_parabolas))
    theirs = optuna.load_study(study_name="tune", storage=f"sqlite:///{tmp_path / 'study.db'}")
    assert theirs.metric_names == [
        "many.settled_error_mean_m.mean",
        "many.position_rmse_m.max",
    ]
    assert len(theirs.get_trials(states=[optuna.trial.TrialState.COMPLETE])) == 4
    assert {trial.values[0] for trial in theirs.best_trials} == {
        trial.objectives[0] for trial in front_of(study.trials()[1:])
    }


VECTORS = """
seed: 1
trials: 4
search:
  mpc.R.1: {log_uniform: [0.0001, 1.0]}
  mpc.R.2: {same_as: mpc.R.1, times: 2.0}
  mpc.omega_max.2: {uniform: [1.0, 2.0]}
  mpc.horizon_steps: {integers: [5, 9]}
  mpc.formulation: {choice: [manifold, paper]}
  mpc.advanced.solver.tolerance: {log_uniform: [0.00001, 0.01]}
campaigns:
  one: {flights: 1, reference: hover, duration: 1.0}
objectives:
  - {campaign: one, figure: position_rmse_m}
"""


def test_parameter_file_repeats_the_chosen_trial(tmp_path: Path) -> None:
    """It is read back by the loader of --config, to the parameters that its flights had."""
    seen: dict[float, MpcConfig] = {}

    def formula(campaign: Campaign, number: int) -> dict[str, Any]:
        mpc = campaign.base["mpc"]
        assert isinstance(mpc, MpcConfig)
        value = 1.0 / (2.0 + len(seen))
        seen[value] = mpc
        return {"position_rmse_m": value}

    study = study_in(tmp_path, VECTORS)
    study.run(FormulaEngine(formula))
    write_results(tmp_path, tuning_of(tmp_path), study.trials())

    best = study.trials()[3]  # each is better than the one before
    loaded = files.load([str(tmp_path / "best.yaml")], [], schema={"mpc": MpcConfig})["mpc"]
    assert isinstance(loaded, MpcConfig)
    flew = seen[best.objectives[0]]
    assert dataclasses.replace(loaded, lockstep=True) == flew
    assert flew.R[2] == 2.0 * flew.R[1]
    assert flew.R[3] == MpcConfig().R[3]
    assert "--seed 1 --out" in results_text(tmp_path, tuning_of(tmp_path), study.trials())


def test_tolerance_prefers_the_first_objective() -> None:
    objectives = [
        Objective(campaign="a", figure=str(place), of="mean", lost=1.0, tolerance=tolerance)
        for place, tolerance in enumerate((0.0, 0.2, 0.0))
    ]
    front = [
        trial_with(number, values)
        for number, values in enumerate(
            [(0.0, 1.0, 9.0), (0.0, 1.15, 7.0), (0.0, 1.3, 1.0), (0.1, 0.5, 0.5)]
        )
    ]
    assert chosen(front_of(front), objectives).number == 1


def trial_with(number: int, objectives: tuple[float, ...]) -> Trial:
    return Trial(
        number=number,
        values={},
        outcome=FLOWN,
        objectives=objectives,
        reason="",
        flights=1,
        lost=0,
        seconds=1.0,
    )


def test_file_of_the_study_is_complete(tmp_path: Path) -> None:
    """Campaigns in files of their own are in it, and reading it gives it again."""
    (tmp_path / "own.yaml").write_text(
        "{flights: 3, duration: 2.0, vary: {simulator.thrust_scale: {uniform: [0.9, 1.1]}}}"
    )
    path = tmp_path / "file.yaml"
    path.write_text(VECTORS.replace("{flights: 1, reference: hover, duration: 1.0}", "own.yaml"))
    text = read_tuning(path).text()
    assert yaml.safe_load(text)["campaigns"]["one"]["flights"] == 3
    again = tmp_path / "elsewhere"
    again.mkdir()
    (again / "tune.yaml").write_text(text)
    assert tuning_of(again).text() == text


BAD = {
    "of the plant": (
        ("mpc.terminal_weight: {uniform", "simulator.mass: {uniform"),
        "search: simulator.mass: expected a parameter of the MPC, mpc.PARAMETER",
    ),
    "unknown parameter": (
        ("mpc.terminal_weight: {uniform", "mpc.terminal_wait: {uniform"),
        "terminal_weight",
    ),
    "beyond the range": (("[0.0, 4.0]", "[-1.0, 4.0]"), "given -1.0, expected a number >= 0"),
    "attitude": (
        ("mpc.terminal_weight: {uniform: [0.0, 4.0]}", "mpc.R: {attitude: [1.0, 0.1]}"),
        "expected uniform, log_uniform",
    ),
    "follows the plant": (
        ("{uniform: [0.0, 4.0]}", "{same_as: simulator.mass}"),
        "expected one of mpc.PARAMETER",
    ),
    "varied, too": (
        ("set: {mpc.terminal_weight: 3.5}", "vary: {mpc.terminal_weight: {uniform: [1, 2]}}"),
        "search: mpc.terminal_weight: many also varies",
    ),
    "two beginnings": (
        ("objectives:", "  other: {flights: 1, reference: hover}\nobjectives:"),
        "the campaigns start with 3.5 and 10.0",
    ),
    "no such campaign": (("campaign: many", "campaign: few"), "given 'few', expected one of many"),
    "no such figure": (("settled_error_mean_m", "beauty"), "given 'beauty', expected one of"),
    "no such statistic": (("of: max", "of: worst"), "given 'worst', expected one of mean, median"),
    "twice": (
        ("position_rmse_m, of: max", "settled_error_mean_m, of: mean"),
        "duplicate",
    ),
    "no unit": (("position_rmse_m", "iterations.p99"), "lost: given None, expected a number"),
    "vector": (
        ("mpc.terminal_weight: {uniform: [0.0, 4.0]}", "mpc.Q: {choice: [[1, 2], [2, 1]]}"),
        "mpc.Q",
    ),
    "unknown key": (("give_up", "giveup"), "did you mean give_up?"),
    "share": (("give_up: 1.0", "give_up: 1.5"), "given 1.5, expected a number from 0 to 1"),
    "trials": (("trials: 25", "trials: 0"), "given 0, expected a whole number"),
    "no file": (("{flights: 40", "nowhere.yaml #"), "nowhere.yaml: cannot be read"),
}


@pytest.mark.parametrize("mistake", BAD)
def test_mistake_is_reported_in_one_line(mistake: str, tmp_path: Path) -> None:
    (old, new), expected = BAD[mistake]
    text = SIMPLE.format(trials=25, give_up=1.0)
    assert old in text
    path = tmp_path / "file.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        read_tuning(path)
    message = str(caught.value)
    assert expected in message
    assert "\n" not in message
    assert message.startswith(str(path))
