"""Options of ``quad_mpc soak``, and what they ask for."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

from quad_mpc_ros.commands.run_options import (
    RunConfig,
    add_configuration_options,
    default_out,
    prepared_out,
    resolve,
)
from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.faults.cases import FAULTS, Fault

RESULT, PICTURE = "soak.json", "soak.png"
_ENDURANCE = 1800.0  # s
_DROPOUT = 0.01
# High enough to be blind for a while, and in motion, so that a frozen odometry can be told.
_REFERENCE, _HEIGHT = "lemniscate", 10.0
_BETWEEN_PROCESSES = {name: fault for name, fault in FAULTS.items() if not fault.grounded}


@dataclass(frozen=True, kw_only=True)
class SoakConfig:
    """What is flown, and the faults to inject; without any it flies on for ``duration`` [s]."""

    run: RunConfig
    faults: tuple[Fault, ...]
    duration: float


def add_soak_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``quad_mpc soak``."""
    parser.add_argument(
        "--faults",
        metavar="NAME,...",
        help="inject these faults one after another instead of flying on and on; 'all' for all "
        "of them, --list tells their names",
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="print the table of the faults and of what each must lead to, and end",
    )
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help=f"length of the flight without faults in seconds (default: {_ENDURANCE:g})",
    )
    parser.add_argument(
        "--dropout",
        type=float,
        metavar="SHARE",
        help=f"share of the odometries lost in that flight (default: {_DROPOUT:g})",
    )
    add_configuration_options(parser, reference=f"{_REFERENCE}, {_HEIGHT:g} m high")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for {RESULT}, {PICTURE} and the nodes' logs; must not hold any "
        "(default: runs/<date-time>_soak)",
    )


def resolve_soak(options: argparse.Namespace) -> SoakConfig:
    """Return what the options ask for, its folder made; raises :class:`UserError`."""
    faults = _faults(options.faults)
    duration, dropout = _endurance(options, faults)
    options.reference = options.reference or _REFERENCE
    options.assignments = [
        # It is ended from outside.
        "simulator.duration=0",
        f"simulator.odom_dropout={dropout}",
        f"reference.height={_HEIGHT}",
        *options.assignments,
    ]
    options.out = prepared_out(options.out or default_out("soak"), holds=(RESULT, PICTURE, "log"))
    options.start = options.plant = None
    options.duration = duration
    run = resolve(options, lockstep=False)
    if run.reference.mode != "at_once":
        raise ConfigurationError(
            "reference.mode", run.reference.mode, "at_once: soak makes no requests"
        )
    return SoakConfig(run=run, faults=faults, duration=duration)


def _endurance(options: argparse.Namespace, faults: tuple[Fault, ...]) -> tuple[float, float]:
    """Return duration and drop-outs of a flight without faults; with faults there are none."""
    for name, given in (("duration", options.duration), ("dropout", options.dropout)):
        if faults and given is not None:
            raise UserError(f"--{name}: goes with a flight without --faults, which say their own")
    dropout = _DROPOUT if options.dropout is None else options.dropout
    duration = _ENDURANCE if options.duration is None else options.duration
    if not 0.0 <= dropout < 1.0:
        raise UserError(f"--dropout: given {dropout}, expected a number >= 0 and < 1")
    if not (math.isfinite(duration) and duration > 0.0):
        raise UserError(f"--duration: given {duration}, expected a number > 0")
    return duration, 0.0 if faults else dropout


def _faults(names: str | None) -> tuple[Fault, ...]:
    if names is None:
        return ()
    if names == "all":
        return tuple(_BETWEEN_PROCESSES.values())
    for name in names.split(","):
        if name not in _BETWEEN_PROCESSES:
            raise UserError(
                f"--faults: given {name!r}, expected all or some of "
                f"{', '.join(_BETWEEN_PROCESSES)}"
            )
    return tuple(_BETWEEN_PROCESSES[name] for name in dict.fromkeys(names.split(",")))
