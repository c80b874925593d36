# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The shipped parameter files and their documentation say what the code says."""

from __future__ import annotations

from pathlib import Path

import pytest
from fixtures.scripts import ROOT, script_module

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import files

GENERATOR = script_module("tools/update_config.py")


NODES = GENERATOR.ALL_NODES


@pytest.mark.parametrize("path", list(GENERATOR.files()))
def test_generated_file_is_current(path: Path) -> None:
    generated = GENERATOR.files()[path]
    assert (ROOT / path).read_text(encoding="utf-8") == generated, "run tools/update_config.py"


@pytest.mark.parametrize("node", list(NODES))
def test_node_file_contains_exactly_the_defaults(node: str) -> None:
    loaded = files.load([str(ROOT / "config" / f"{node}.yaml")], [], schema=NODES)
    assert loaded[node] == NODES[node]()


def test_presets_differ_only_in_documented_parameters() -> None:
    paper = files.load(["paper"], [], schema=SCHEMA)
    rigid = files.load(["paper_rigid_body"], [], schema=SCHEMA)
    differences = {
        f"{node}.{name}"
        for node in SCHEMA
        for name, value in paper[node].flattened().items()
        if rigid[node].flattened()[name] != value
    }
    assert differences == {"simulator.dynamics"}
    assert paper["simulator"].flattened()["dynamics"] == "paper"
