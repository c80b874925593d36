# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of every kind that are broken by chance: read, or refused in one line.

``bench/fuzz_files.py`` does the same with ten thousand of each kind.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_files import Kind, fuzz, kinds

_COUNT, _COUNT_OF_BAGS = 20, 6
_NAMES = (
    *("parameters", "vehicle", "gates", "obstacles", "campaign", "tune", "points", "motion"),
    *("metadata.yaml", "mcap", "mcap unchecked", "db3"),
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    return {kind.name: kind for kind in kinds(tmp_path_factory.mktemp("sound"))}


def test_every_kind_of_file_is_mutated(sound: dict[str, Kind]) -> None:
    assert tuple(sound) == _NAMES


@pytest.mark.parametrize("name", _NAMES)
def test_valid_files_are_read_and_mutated_files_never_crash(
    name: str, sound: dict[str, Kind], tmp_path: Path
) -> None:
    count = _COUNT_OF_BAGS if name in ("metadata.yaml", "mcap", "mcap unchecked") else _COUNT
    outcomes, failures = fuzz(sound[name], count=count, seed=43, folder=tmp_path)
    assert not failures
    assert outcomes["refused"] > 0
