# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Model predictive control of a quadrotor on SO(3), for ROS 2 and without it.

These names are the public API. No name needs ROS; each name is imported on first use.

- to control: :class:`.Controller`, :class:`.MpcConfig`, :class:`.Vehicle`;
- inputs and outputs: :class:`.OdometrySample`, :class:`.ReferenceWindow`, :class:`.CommandSample`,
  and :class:`.RotorCommand` for controllers of rotors;
- to simulate: :func:`.simulate`, :class:`.SimulatorConfig`, :class:`.ReferenceConfig`, with
  :func:`.load_config` for presets and parameter files, :class:`.FunctionPath` for a reference
  p(t), and :func:`.simulate_run` to save the flight;
- to plan a race through gates: :func:`.plan_race` (the extra ``plan``);
- to read and evaluate a flight: :class:`.Recording`, :class:`.Flight`, :func:`.summarise`;
- to identify a vehicle: :func:`.identify`;
- rotations: :mod:`so3 <quad_mpc_ros.control.lie.so3>`.

World frame ENU, body frame FLU, SI units, radians; stamps are integer nanoseconds. ``p_WB`` is the
position of the body in the world, ``v_WB_B`` the velocity in body axes, ``w_WB_B`` the body rates,
``R_WB`` the attitude, with the body's axes as columns.

Example:
    >>> from quad_mpc_ros import Controller, MpcConfig, OdometrySample, ReferenceWindow
    >>> controller = Controller(MpcConfig())
    >>> odometry = OdometrySample.at_rest([0.0, 0.0, 1.0])
    >>> tick = controller.step(odometry, ReferenceWindow.hover([0.0, 0.0, 2.0]))
    >>> tick.command.throttle > MpcConfig().vehicle().hover_throttle
    True
"""

from __future__ import annotations

# As of typing, which takes long to import: executables begin here, deaf until they go on.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from quad_mpc_ros.analysis.identification.fit import identify
    from quad_mpc_ros.commands.simulate import simulate_run
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.control.controller import Controller
    from quad_mpc_ros.control.lie import so3
    from quad_mpc_ros.control.model.samples import (
        CommandSample,
        OdometrySample,
        ReferenceWindow,
        RotorCommand,
    )
    from quad_mpc_ros.control.model.vehicle import Vehicle
    from quad_mpc_ros.extras.racing.planning.race_plan import plan_race
    from quad_mpc_ros.recordings.evaluation.metrics import summarise
    from quad_mpc_ros.recordings.evaluation.simulated import load_config, simulate
    from quad_mpc_ros.recordings.flight import Flight
    from quad_mpc_ros.recordings.recording import Recording
    from quad_mpc_ros.references.config import ReferenceConfig
    from quad_mpc_ros.references.function_path import FunctionPath
    from quad_mpc_ros.simulation.config import SimulatorConfig

__version__ = "1.0.0"

__all__ = [
    "CommandSample",
    "Controller",
    "Flight",
    "FunctionPath",
    "MpcConfig",
    "OdometrySample",
    "Recording",
    "ReferenceConfig",
    "ReferenceWindow",
    "RotorCommand",
    "SimulatorConfig",
    "Vehicle",
    "identify",
    "load_config",
    "plan_race",
    "simulate",
    "simulate_run",
    "so3",
    "summarise",
]

# Where each name comes from; the imports above say the same to type checkers.
_MODULES = {
    "CommandSample": "control.model.samples",
    "Controller": "control.controller",
    "Flight": "recordings.flight",
    "FunctionPath": "references.function_path",
    "MpcConfig": "control.config",
    "OdometrySample": "control.model.samples",
    "Recording": "recordings.recording",
    "ReferenceConfig": "references.config",
    "ReferenceWindow": "control.model.samples",
    "RotorCommand": "control.model.samples",
    "SimulatorConfig": "simulation.config",
    "Vehicle": "control.model.vehicle",
    "identify": "analysis.identification.fit",
    "load_config": "recordings.evaluation.simulated",
    "plan_race": "extras.racing.planning.race_plan",
    "simulate": "recordings.evaluation.simulated",
    "simulate_run": "commands.simulate",
    "so3": "control.lie",
    "summarise": "recordings.evaluation.metrics",
}


def __getattr__(name: str) -> object:
    """Import a name of the library on first use (PEP 562)."""
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # With fromlist, as of a from statement, a name may be a module that nothing has imported yet.
    value: object = getattr(__import__(f"{__name__}.{module}", fromlist=[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
