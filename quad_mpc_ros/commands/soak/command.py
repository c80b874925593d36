"""``quad_mpc soak``: an endurance, or a campaign of faults."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.commands.soak.options import PICTURE, RESULT, SoakConfig, resolve_soak
from quad_mpc_ros.faults.table import fault_table

EXIT_FAILED = 1


def soak(options: argparse.Namespace) -> int:
    """Fly, judge and tell; return the exit code, 0 only when all holds."""
    if options.list:
        print(fault_table())
        return 0
    require_ros("soak")
    config = resolve_soak(options)
    # Other machines on the network fly their own; who wants them to hear this sets the variable.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    holds = _faults_hold(config) if config.faults else _endures(config)
    print(f"\nresult   {config.run.out / RESULT}\npicture  {config.run.out / PICTURE}")
    print("All holds." if holds else "It does not hold.")
    return 0 if holds else EXIT_FAILED


def _faults_hold(config: SoakConfig) -> bool:
    """Inject the faults and tell of each as soon as it is judged."""
    from quad_mpc_ros.commands.soak.campaign import Outcome, campaign
    from quad_mpc_ros.commands.soak.results import outcome_figures, outcome_lines, write_results
    from quad_mpc_ros.commands.soak.rig import Rig, SoakError

    print(f"injecting {len(config.faults)} faults into {config.run.out}", file=sys.stderr)
    outcomes: list[Outcome] = []
    wrong: list[str] = []
    with Rig(config.run, relays=True) as rig:
        try:
            for outcome in campaign(config.faults, rig, config.run.mpc):
                outcomes.append(outcome)
                print("\n".join(outcome_lines(outcome)), flush=True)
        except SoakError as error:
            wrong.append(str(error))
        # Also between the faults.
        wrong += rig.watch.unsound[:1]
        holding = sum(not outcome.complaints for outcome in outcomes)
        holds = not wrong and holding == len(config.faults)
        result = {
            "holds": holds,
            "complaints": wrong,
            "commands": len(rig.watch.commands_ns),
            "unsound_commands": len(rig.watch.unsound),
            "faults": outcome_figures(outcomes),
            "config": _parameters(config),
        }
        write_results(config.run.out, result, rig, config=config.run.mpc, outcomes=outcomes)
    print(f"\n{holding} of {len(config.faults)} faults hold, {result['commands']} commands")
    for complaint in wrong:
        print(f"error: {complaint}", file=sys.stderr)
    return holds


def _endures(config: SoakConfig) -> bool:
    """Fly on and on."""
    from quad_mpc_ros.commands.soak.endurance import endurance_complaints, endure, figures
    from quad_mpc_ros.commands.soak.results import endurance_table, write_results
    from quad_mpc_ros.commands.soak.rig import Rig, SoakError

    mpc = config.run.mpc
    print(f"flying for {config.duration:g} s into {config.run.out}", file=sys.stderr)
    found: dict[str, Any] = {}
    with Rig(config.run, relays=False) as rig:
        try:
            seen = endure(rig, mpc, duration=config.duration)
            found = figures(rig, seen, mpc)
            wrong = endurance_complaints(found, rig.watch.unsound)
        except SoakError as error:
            wrong = [str(error)]
        result = {
            "holds": not wrong,
            "complaints": wrong,
            **found,
            "config": _parameters(config),
        }
        write_results(config.run.out, result, rig, config=mpc)
    if found:
        print(endurance_table(found))
    for complaint in wrong:
        print(f"error: {complaint}", file=sys.stderr)
    return not wrong


def _parameters(config: SoakConfig) -> dict[str, Any]:
    run = config.run
    return {node: getattr(run, node).flattened() for node in ("mpc", "simulator", "reference")}
