"""The MPC node with a solver and a clock that fail on demand, for ``quad_mpc soak`` alone.

Nothing of this is in the node that flies: this module derives from it and puts a stand-in in
OSQP's place before the node is made.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

from rclpy.duration import Duration
from std_srvs.srv import SetBool

from quad_mpc_ros.experiments.faults.cases import FAULTS
from quad_mpc_ros.experiments.faults.solver import FaultySolver, SolverFault
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.spin import run

_LONG = 1.5  # control periods


class ShiftedClock:
    """A clock with an offset; otherwise the one that it wraps."""

    def __init__(self, clock: Any) -> None:
        self._clock = clock
        self.shift = Duration()

    def now(self) -> Any:
        """Return the time that the clock shows."""
        return self._clock.now() + self.shift

    def __getattr__(self, name: str) -> Any:
        return getattr(self._clock, name)


class MpcNodeWithFaults(MpcNode):
    """Serves ``~/fault/NAME`` (std_srvs/SetBool) for each fault of the solver and the clock."""

    def __init__(self, solver: FaultySolver) -> None:
        self._shifted: ShiftedClock | None = None
        super().__init__()
        self._faulty_solver = solver
        for fault in SolverFault:
            serve = functools.partial(self._on_solver_fault, fault)
            self.create_service(SetBool, f"~/fault/{fault.value}", serve)
        for case in FAULTS.values():
            if case.clock:
                serve = functools.partial(self._on_clock_fault, case.clock)
                self.create_service(SetBool, f"~/fault/{case.switch}", serve)

    def get_clock(self) -> Any:
        """Return the clock of the node, as it was set."""
        if self._shifted is None:
            self._shifted = ShiftedClock(super().get_clock())
        return self._shifted

    def _on_solver_fault(self, fault: SolverFault, request: Any, response: Any) -> Any:
        self._faulty_solver.long = _LONG / self.get_parameter("control_rate").value
        self._faulty_solver.fault = fault if request.data else None
        response.success = True
        return response

    def _on_clock_fault(self, seconds: float, request: Any, response: Any) -> Any:
        self.get_clock().shift = Duration(seconds=seconds if request.data else 0.0)
        response.success = True
        return response


def main(args: list[str] | None = None) -> None:
    """Run the node: ``python -m quad_mpc_ros.commands.soak.mpc_with_faults``."""
    solver = FaultySolver()
    with solver.installed():
        sys.exit(run(functools.partial(MpcNodeWithFaults, solver), args))


if __name__ == "__main__":
    main()
