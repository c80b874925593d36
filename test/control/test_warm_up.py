# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""After warming up nothing is left to compile, as that would take seconds in flight."""

from __future__ import annotations

import subprocess
import sys

import pytest

# In a process of its own, where nothing has been compiled by other tests.
FLY = """
import sys
from quad_mpc_ros.configuration.compilation import FUNCTIONS
from quad_mpc_ros.control.config import ConsistencyParameters, MpcConfig
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

PLACES = tuple(
    f"quad_mpc_ros.control.{place}." for place in ("safety", "estimation", "ocp", "model")
)

def compiled():
    return {
        (function.py_func.__module__, function.py_func.__name__, str(signature))
        for function in FUNCTIONS if function.py_func.__module__.startswith(PLACES)
        for signature in function.signatures
    }

lag = float(sys.argv[1])
mpc = MpcConfig(
    rate_time_constant=lag, thrust_time_constant=lag, input_delay=lag, lockstep=True,
    formulation=sys.argv[2], consistency=ConsistencyParameters(action="warn"),
)
warmed_up(mpc)
before = compiled()
reference = ReferenceConfig(trajectory="lemniscate")
for _ in fly(mpc=mpc, simulator=SimulatorConfig(duration=1.0), reference=reference):
    pass
print(*sorted(compiled() - before), sep="\\n")
assert before
"""


@pytest.mark.parametrize(
    ("lag", "formulation"),
    [("0.0", "manifold"), ("0.02", "manifold"), ("0.3", "manifold"), ("0.02", "contouring")],
)
def test_warm_up_compiles_all_code(lag: str, formulation: str) -> None:
    flown = subprocess.run(
        [sys.executable, "-c", FLY, lag, formulation], capture_output=True, text=True, check=False
    )
    assert flown.returncode == 0, flown.stderr
    assert flown.stdout.strip() == ""


# The node also takes warnings, and lower levels of the failsafe fly at times.
FAIL = (
    FLY.split("reference = ")[0].replace("lockstep=True", "lockstep=False")
    + """
import numpy as np
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.references.server import ReferenceServer
server = ReferenceServer(ReferenceConfig(trajectory="lemniscate"))
server.start(0)
windows = [server.window(20_000_000 * k) for k in range(30)]
controller = warmed_up(mpc)
before, sources = compiled(), set()

def seen(tick):
    if tick is not None:
        sources.add(tick.decision.source.name)
    controller.take_warnings()

def odometry(stamp_ns):
    return OdometrySample(
        stamp_ns=stamp_ns, p_WB=np.array([1e-9 * stamp_ns, 0.0, 2.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]), v_WB_B=np.array([1.0, 0.0, 0.0]),
        w_WB_B=np.zeros(3),
    )

for k in range(100):
    now_ns = 20_000_000 * k
    if k < 30:
        seen(controller.receive_reference(windows[k], now_ns=now_ns))
    seen(controller.receive_odometry(odometry(now_ns), now_ns=now_ns))
for _ in range(30):
    now_ns += 20_000_000
    seen(controller.watch(now_ns=now_ns))
assert sources >= {"MPC", "PLAN", "HOVER", "BLIND"}, sources
print(*sorted(compiled() - before), sep="\\n")
"""
)


@pytest.mark.parametrize("lag", ["0.0", "0.02"])
def test_warm_up_compiles_the_failsafe_code(lag: str) -> None:
    flown = subprocess.run(
        [sys.executable, "-c", FAIL, lag, "manifold"], capture_output=True, text=True, check=False
    )
    assert flown.returncode == 0, flown.stderr
    assert flown.stdout.strip() == ""
