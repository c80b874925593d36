"""After warming up nothing is left to compile, which in the air would take seconds."""

from __future__ import annotations

import subprocess
import sys

import pytest

# In a process of its own, where nothing has been compiled by other tests.
FLY = """
import sys
from numba.core.dispatcher import Dispatcher
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

def compiled():
    return {
        (module, name, str(signature))
        for module in list(sys.modules) if module.startswith("quad_mpc_ros.control")
        for name, value in vars(sys.modules[module]).items() if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

lag = float(sys.argv[1])
mpc = MpcConfig(
    rate_time_constant=lag, thrust_time_constant=lag, input_delay=lag, lockstep=True
)
warmed_up(mpc)
before = compiled()
reference = ReferenceConfig(trajectory="lemniscate")
for _ in fly(mpc=mpc, simulator=SimulatorConfig(duration=1.0), reference=reference):
    pass
print(*sorted(compiled() - before), sep="\\n")
assert before
"""


@pytest.mark.parametrize("lag", ["0.0", "0.02", "0.3"])
def test_nothing_is_left_to_compile(lag: str) -> None:
    flown = subprocess.run(
        [sys.executable, "-c", FLY, lag], capture_output=True, text=True, check=False
    )
    assert flown.returncode == 0, flown.stderr
    assert flown.stdout.strip() == ""
