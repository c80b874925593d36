"""``quad_mpc soak``: an endurance, or a campaign of faults."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from quad_mpc_ros.commands import EXIT_FAILED
from quad_mpc_ros.commands.output import check_free, default_out
from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.commands.run_options import add_configuration_options, add_out, check_duration
from quad_mpc_ros.configuration import ConfigurationError, UserError

if TYPE_CHECKING:
    from quad_mpc_ros.commands.run_configuration import RunConfig
    from quad_mpc_ros.experiments.faults.cases import Fault

RESULT, PICTURE = "soak.json", "soak.png"
_ENDURANCE = 1800.0  # s
_DROPOUT = 0.01
# High enough to be blind for a while, and in motion, so that a frozen odometry can be detected.
_REFERENCE, _HEIGHT = "lemniscate", 10.0


@dataclass(frozen=True, kw_only=True)
class SoakConfig:
    """What is flown, and the faults to inject; without any it flies on for ``duration`` [s]."""

    run: RunConfig
    faults: tuple[Fault, ...]
    duration: float


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add how to fly and which faults to inject."""
    parser.description = (
        "Fly over DDS with 1 % of the odometries lost and parameters changed every second, "
        "and report whether a tick was late, a rung below the last plan was needed or memory "
        "grew; or, with --faults, let odometry, reference, solver, clocks and processes fail "
        "and report whether each fault led to the rung of the safety ladder that it must, in "
        "time, and back. Every command is checked: finite, and within its bounds. Exit code 0 "
        "only when all holds, 1 otherwise, 2 for bad input."
    )
    parser.add_argument(
        "--faults",
        metavar="NAME,...",
        help="inject these faults one after another instead of an endurance flight; 'all' for all "
        "of them, --list prints their names",
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
    add_out(parser, f"{RESULT}, {PICTURE} and the nodes' logs; must not hold any", "soak")


def run(options: argparse.Namespace) -> int:
    """Fly and judge; return the exit code, 0 only when all holds."""
    if options.list:
        from quad_mpc_ros.experiments.faults.cases import fault_table

        print(fault_table())
        return 0
    require_ros("soak")
    config = _configuration(options)
    # Other machines on the network fly, too; set the variable to share this flight with them.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    holds = _faults_hold(config) if config.faults else _endures(config)
    print(f"\nresult   {config.run.out / RESULT}\npicture  {config.run.out / PICTURE}")
    print("All holds." if holds else "It does not hold.")
    return 0 if holds else EXIT_FAILED


def _faults_hold(config: SoakConfig) -> bool:
    """Inject the faults and report each as soon as it is judged; return whether all hold."""
    from quad_mpc_ros.commands.soak import results
    from quad_mpc_ros.commands.soak.campaign import Outcome, campaign
    from quad_mpc_ros.commands.soak.rig import Rig, SoakError
    from quad_mpc_ros.recordings.evaluation.crash import crash_figures

    run = config.run
    print(f"injecting {len(config.faults)} faults into {run.out}", file=sys.stderr)
    outcomes: list[Outcome] = []
    wrong: list[str] = []
    with Rig(run, relays=True) as rig:
        try:
            for outcome in campaign(config.faults, rig, run.mpc):
                outcomes.append(outcome)
                print("\n".join(results.outcome_lines(outcome)), flush=True)
        except SoakError as error:
            wrong.append(str(error))
        # Also between the faults.
        wrong += rig.watch.unsound[:1]
        crash = rig.motion.crash()
        wrong += [crash.text] if crash is not None else []
        found = {
            **crash_figures(crash),
            "commands": len(rig.watch.commands_ns),
            "unsound_commands": len(rig.watch.unsound),
            "faults": results.outcome_figures(outcomes),
        }
        results.write_results(
            run, found, rig, files=(RESULT, PICTURE), wrong=wrong, outcomes=outcomes
        )
    holding = sum(not outcome.complaints for outcome in outcomes)
    print(f"\n{holding} of {len(config.faults)} faults hold, {found['commands']} commands")
    return _holds(wrong) and holding == len(config.faults)


def _endures(config: SoakConfig) -> bool:
    """Fly for the duration; return whether all held."""
    from quad_mpc_ros.commands.soak import endurance, results
    from quad_mpc_ros.commands.soak.rig import Rig, SoakError

    run = config.run
    print(f"flying for {config.duration:g} s into {run.out}", file=sys.stderr)
    found: dict[str, Any] = {}
    with Rig(run, relays=False) as rig:
        try:
            seen = endurance.endure(rig, run.mpc, duration=config.duration)
            found = endurance.figures(rig, seen, run.mpc)
            wrong = endurance.endurance_complaints(found, rig.watch.unsound)
        except SoakError as error:
            wrong = [str(error)]
        results.write_results(run, found, rig, files=(RESULT, PICTURE), wrong=wrong)
    if found:
        print(results.endurance_table(found))
    return _holds(wrong)


def _holds(wrong: list[str]) -> bool:
    """Print what is wrong; return whether nothing is."""
    for complaint in wrong:
        print(f"error: {complaint}", file=sys.stderr)
    return not wrong


def _configuration(options: argparse.Namespace) -> SoakConfig:
    """Return what the options ask for, its folder made; raises :class:`UserError`."""
    from quad_mpc_ros.commands.run_configuration import run_configuration

    faults = _faults(options.faults)
    duration, dropout = _endurance(options, faults)
    options.reference = options.reference or _REFERENCE
    options.assignments = [
        # Without an end of its own: this process ends it.
        "simulator.duration=0",
        f"simulator.odom_dropout={dropout}",
        f"reference.height={_HEIGHT}",
        *options.assignments,
    ]
    options.out = options.out or default_out("soak")
    check_free(options.out, holds=(RESULT, PICTURE, "log"))
    options.start = options.plant = options.obstacles = options.sensor = None
    options.duration = duration
    run = run_configuration(options, lockstep=False)
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
    check_duration(duration)
    return duration, 0.0 if faults else dropout


def _faults(names: str | None) -> tuple[Fault, ...]:
    """Return the faults by their names, of those that can be injected between processes."""
    from quad_mpc_ros.experiments.faults.cases import FAULTS

    if names is None:
        return ()
    known = {name: fault for name, fault in FAULTS.items() if not fault.grounded}
    if names == "all":
        return tuple(known.values())
    for name in names.split(","):
        if name not in known:
            raise UserError(
                f"--faults: given {name!r}, expected all or some of {', '.join(known)}"
            )
    return tuple(known[name] for name in dict.fromkeys(names.split(",")))
