# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each bridge flies with the installed messages of its stack as well as without a bridge."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from fixtures import stack_over_dds
from fixtures.installed_ros import environment

pytestmark = pytest.mark.timeout(400)  # of a busy machine

CASES = ("px4", "mavros", "rosflight", "aerostack2", "crazyswarm2")
SCRIPT = Path(stack_over_dds.__file__)


@pytest.fixture(scope="module")
def flights(another_domain: Callable[[], str]) -> Iterator[dict[str, Future[dict[str, Any]]]]:
    """Fly all cases, two at a time; simulated time waits for all answers."""
    with ThreadPoolExecutor(2) as pool:
        yield {case: pool.submit(flown, case, domain=another_domain()) for case in CASES}


def flown(case: str, *, domain: str) -> dict[str, Any]:
    """Return the results of a process that flies a case; its nodes end with it."""
    env = environment()
    path = [str(SCRIPT.parents[1]), env.get("PYTHONPATH", "")]
    process = subprocess.Popen(
        ["python3", "-P", str(SCRIPT), case],
        env={**env, "ROS_DOMAIN_ID": domain, "PYTHONPATH": ":".join(filter(None, path))},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        output, log = process.communicate(timeout=300)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, log
    found: dict[str, Any] = json.loads(output)
    return found


@pytest.mark.parametrize("case", CASES)
def test_the_square_is_flown_with_messages_of_the_stack_as_well_as_without_a_bridge(
    case: str, flights: dict[str, Future[dict[str, Any]]]
) -> None:
    flight = flights[case].result()
    if "missing" in flight:
        pytest.skip(f"not installed: {', '.join(flight['missing'])}")
    assert flight["errors"] == flight["errors_without"] > 150
    assert flight["rmse"] <= 1.05 * flight["rmse_without"]
    assert flight["fallbacks"] == flight["rejected_inputs"] == 0
