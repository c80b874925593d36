# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The compile cache: one folder for each installation, as Numba looks functions up."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import quad_mpc_ros
from quad_mpc_ros.configuration.compilation import source_files

PACKAGE = Path(quad_mpc_ros.__file__).parent
NAMES_FOLDER = (
    "from quad_mpc_ros.configuration.compilation import cache_folder; print(cache_folder())"
)


def folder_of(installation: Path, cache: Path) -> str:
    """Return the cache folder that a new process uses with an installation."""
    environment = {**os.environ, "PYTHONPATH": str(installation), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-P", "-c", NAMES_FOLDER]
    return subprocess.check_output(command, env=environment, text=True)


def test_installations_and_reinstallations_do_not_share_a_cache(tmp_path: Path) -> None:
    """Numba would find nothing there, and ``quad_mpc compile`` would take it as complete."""
    first, second = tmp_path / "first", tmp_path / "second"
    for place in (first, second):
        shutil.copytree(PACKAGE, place / "quad_mpc_ros")
    folders = [folder_of(place, tmp_path / "cache") for place in (first, second, first)]
    assert folders[0] == folders[2] != folders[1]

    installed = first / next(iter(source_files())).relative_to(PACKAGE.parent)
    os.utime(installed, (1.0, 1.0))
    assert folder_of(first, tmp_path / "cache") not in folders
