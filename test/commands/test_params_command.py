# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc params`` prints the parameters that are asked for."""

from __future__ import annotations

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.run_configuration import SCHEMA


def test_lists_every_parameter_with_type_default_unit_range_and_meaning(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["params"]) == 0
    printed = capsys.readouterr().out
    for node, kind in SCHEMA.items():
        for spec in kind.specs():
            (line,) = [
                line
                for line in printed.splitlines()
                if line.split(" ")[0] == f"{node}.{spec.name}"
            ]
            assert spec.kind in line
            assert spec.allowed() in line
            assert spec.unit in line
            assert line.endswith("live") == spec.live
            assert spec.doc.split(".")[0][:40] in printed


def test_lists_a_group_or_a_single_parameter(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["params", "mpc.fence", "/simulator.wind"]) == 0
    first = [line.split(" ")[0] for line in capsys.readouterr().out.splitlines()]
    named = [name for name in first if "." in name]
    assert named == [
        "mpc.fence.minimum",
        "mpc.fence.maximum",
        "mpc.fence.action",
        "simulator.wind",
    ]
