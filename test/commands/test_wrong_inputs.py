# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whatever is wrong with what a command or node is given: one line, exit code 2, nothing touched.

The cases are generated from what commands, nodes and parameters declare, new ones included: some
for each option, of all kinds of wrong input.
"""

from __future__ import annotations

import gc
import importlib
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest
from fixtures.wrong_inputs import (
    Case,
    cases,
    every_case,
    executables,
    make_workspace,
    tree,
    wrong_values,
)

from quad_mpc_ros import cli, entry
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.configuration.files import value_text
from quad_mpc_ros.ros.bridges.node import run_bridge
from quad_mpc_ros.ros.bridges.registry import load_bridge

CASES = cases()
_PATIENCE = 20  # s: what is not refused would begin to fly


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("wrong")
    run = tmp_path_factory.mktemp("flown") / "run"
    flight = ["simulate", "--duration", "0.2", "--out", str(run)]
    assert cli.main(flight) in (0, 1)
    make_workspace(folder, run / "bag")
    yield folder
    gc.collect()  # nodes that could not be made


@pytest.fixture
def impatient() -> Iterator[None]:
    def give_up(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError("it was not refused")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(_PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def exit_code(case: Case) -> int:
    """Return how a command or node ends, in this process."""
    try:
        if case.program in cli.COMMANDS:
            return cli.main([case.program, *case.arguments])
        if case.program.endswith("_bridge"):
            return run_bridge(load_bridge(case.program), list(case.arguments))
        main = importlib.import_module(entry.module_of(case.program)).main
        first = [case.program] if case.program == "stack_node" else []
        return int(main([*first, *case.arguments]))
    except SystemExit as end:
        return int(end.code or 0)


NAMED = {f"{case.kind}: {case.name}": case for case in CASES}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", NAMED)
def test_wrong_input_is_rejected_in_one_line(
    name: str, workspace: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    case = NAMED[name]
    if case.as_user and os.geteuid() == 0:
        pytest.skip("root may read everything")
    monkeypatch.chdir(workspace)
    before = tree(workspace)

    code = exit_code(case)

    printed = capfd.readouterr()
    assert code == 2, printed
    assert printed.out == ""
    missing = re.search(r"needs Optuna|message package .* is not installed", printed.err)
    if missing:
        pytest.skip(missing[0])
    # Nodes of the same process may have said that they are there, and of a bag that ends early it
    # is said before what it lacks.
    said = ("[INFO]", "warning: ")
    lines = [line for line in printed.err.splitlines() if not line.startswith(said)]
    assert lines[0].startswith("error: "), printed.err
    assert [line for line in lines[1:] if not line.startswith("see ")] == []
    for word in case.given:
        assert word in lines[0]
    assert tree(workspace) == before


def test_every_parameter_refuses_every_wrong_value_and_a_misspelt_name() -> None:
    accepted = []
    for node, kind in SCHEMA.items():
        for spec in kind.specs():
            name = f"{node}.{spec.name}"
            wrong = {
                f"{name}={value_text(value)}": f"{name}: given " for _, value in wrong_values(spec)
            }
            wrong[f"{name}x=1"] = f"did you mean {spec.name}?"
            for assignment, complaint in wrong.items():
                try:
                    files.load([], [assignment], schema={node: kind})
                except UserError as error:
                    refused = complaint in str(error)
                else:
                    refused = False
                if not refused:
                    accepted.append(assignment)
    assert accepted == []


def test_every_program_and_every_kind_of_wrong_input_occurs() -> None:
    every = list(every_case())
    assert {case.program for case in CASES} == {case.program for case in every}
    assert {case.program for case in CASES} >= {*cli.COMMANDS, *executables()}
    assert {case.kind for case in CASES} == {case.kind for case in every}
