# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of tests with an installed ROS 2."""

from __future__ import annotations

import fcntl
import tempfile
from pathlib import Path

import pytest
from fixtures.installed_ros import environment, ros2


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    """Compile, as README says: nodes that start together would all do it at once.

    Skips the tests where there is no ROS 2 or not this package in it.
    """
    environment()
    with Path(tempfile.gettempdir(), "quad_mpc_ros_test_compile.lock").open("a") as one_by_one:
        fcntl.flock(one_by_one, fcntl.LOCK_EX)
        ros2("run", "quad_mpc_ros", "quad_mpc", "compile", patience=600.0)
