"""The command line ``quad_mpc``."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command; ``options`` and ``run`` name a function in ``commands`` as module:function.

    Without ``options`` it takes none. Only those of the command that is asked for are imported,
    which takes a moment.
    """

    name: str
    help: str
    description: str
    run: str
    options: str = ""


COMMANDS = (
    Command(
        name="fly",
        help="fly over DDS: simulator, reference, mpc and recorder as processes of their own",
        description="Start simulator, reference, mpc and recorder as separate ROS 2 processes, "
        "fly, stop them, and write DIR/bag (rosbag2, MCAP), DIR/summary.json, DIR/figures/*.png "
        "and DIR/log. Exit code 0 only for a flight without failsafe, 2 for bad input.",
        options="run_options:add_fly_options",
        run="fly:fly",
    ),
    Command(
        name="simulate",
        help="fly the same in one process without ROS, faster than real time",
        description="Fly the closed loop in one process, without ROS. Writes the same files as "
        "'fly'; the commands are those of 'fly --lockstep', bit for bit.",
        options="run_options:add_simulate_options",
        run="simulate:simulate",
    ),
    Command(
        name="check-reference",
        help="judge a reference before it is flown: throttle and body rates against the limits",
        description="Print and draw what a reference needs along its whole way against the "
        "vehicle's limits. Exit code 0 when it is feasible, 1 when it is not, 2 for bad input.",
        options="check_reference:add_check_options",
        run="check_reference:check_reference",
    ),
    Command(
        name="report",
        help="show recorded runs on one page: path, errors, inputs, solver, fallbacks",
        description="Make a self-contained HTML page of one recorded run, or of several beside "
        "each other, with figures to zoom in and a table of the figures of merit. Needs Plotly: "
        "pip install 'quad_mpc_ros[report]'. Exit code 2 for a bag that cannot be used.",
        options="report_options:add_report_options",
        run="report:report",
    ),
    Command(
        name="identify",
        help="fit lags, delay, thrust and drag of the vehicle to a recorded flight",
        description="Fit the lags of body rates and thrust, the input delay, the thrust per mass "
        "and the drag to the commands and the odometry of a flight. Prints a ROS parameter file "
        "for --config on standard output, and what was found with its 95 %% intervals on standard "
        "error.",
        options="recording_options:add_identify_options",
        run="identify:identify_command",
    ),
    Command(
        name="save-vehicle",
        help="save what a flying controller has learned of thrust and lags to a parameter file",
        description="Watch the estimates of a running MPC node for a few seconds of flight, and "
        "print its vehicle with them as a ROS parameter file for --config. The vehicle flies on "
        "as it was: the file is for the next start. Exit code 2 when the MPC does not fly or the "
        "estimates have not settled.",
        options="vehicle_options:add_save_vehicle_options",
        run="save_vehicle:save_vehicle",
    ),
    Command(
        name="resolve",
        help="feed a recorded flight to the controller: what would it have commanded?",
        description="Feed the recorded odometry and reference to the controller, without ROS, and "
        "compare its commands with the recorded ones. With the recorded parameters, which are the "
        "default, they are the same; --config and --set ask what others would have commanded. "
        "Writes DIR/bag, DIR/summary.json and DIR/figures/commands.png.",
        options="recording_options:add_resolve_options",
        run="resolve:resolve_command",
    ),
    Command(
        name="replay",
        help="publish a recorded bag again",
        description="Publish the messages of a bag on their topics again, in the time in which "
        "they were recorded. Pause and go on by the services /player/pause and /player/resume. "
        "Exit code 2 for a bag that cannot be played.",
        options="bag_options:add_replay_options",
        run="replay:replay",
    ),
    Command(
        name="bag",
        help="look into a bag, or repair one",
        description="Look into a bag, or repair one.",
        options="bag_options:add_bag_commands",
        run="bag:bag",
    ),
    Command(
        name="params",
        help="print every parameter: type, default, unit, range, whether live, meaning",
        description="Print what can be set on the nodes, or on some of them. Live parameters may "
        "change in flight (ros2 param set); the others are taken when a node is configured. "
        "Exit code 2 for an unknown name.",
        options="params_options:add_params_options",
        run="params:print_parameters",
    ),
    Command(
        name="bridges",
        help="list the bridges to flight stacks and what is installed for them",
        description="List every registered bridge, and for those whose message package is "
        "missing how to get it. Start one with: ros2 run quad_mpc_ros NAME.",
        run="bridges:list_bridges",
    ),
    Command(
        name="soak",
        help="does it hold: fly for half an hour, or inject faults one after another",
        description="Fly over DDS with 1 % of the odometries lost and parameters changed every "
        "second, and tell whether a tick was late, a rung below the last plan was needed or "
        "memory grew; or, with --faults, let odometry, reference, solver, clocks and processes "
        "fail and tell whether each fault led to the rung of the safety ladder that it must, in "
        "time, and back. Every command is checked: finite, and within its bounds. Exit code 0 "
        "only when all holds, 1 otherwise, 2 for bad input.",
        options="soak.options:add_soak_options",
        run="soak.command:soak",
    ),
    Command(
        name="bench",
        help="measure this controller beside acados, cvxpy and OSQP's own time",
        description="Fly the square on the true rigid body with each peer in turn, in one "
        "process, and tell what a step costs: this controller, acados (SQP_RTI, HPIPM), the same "
        "QP through cvxpy rebuilt at every step, and the solvers' own times; then the cost "
        "against the length of the horizon. The peers are optional: pip install "
        "'quad_mpc_ros[bench]'. Exit code 2 for bad input.",
        options="bench_options:add_bench_options",
        run="bench:bench",
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failsafe or failure, 2 bad input."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = _parser(given).parse_args(given)
    try:
        return int(_function(options.run)(options))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser, with the options of the command that is asked for."""
    parser = argparse.ArgumentParser(
        prog="quad_mpc",
        description="Model predictive control of a quadrotor on SO(3).",
        epilog="Every command explains itself: quad_mpc COMMAND --help.",
    )
    parser.add_argument("--version", action="version", version=f"quad_mpc {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        subparser = commands.add_parser(
            command.name, help=command.help, description=command.description
        )
        if command.options and command.name in arguments:
            _function(command.options)(subparser)
        subparser.set_defaults(run=command.run)
    return parser


def _function(name: str) -> Callable[..., Any]:
    module, function = name.split(":")
    found: Callable[..., Any] = getattr(
        importlib.import_module(f"quad_mpc_ros.commands.{module}"), function
    )
    return found


if __name__ == "__main__":
    sys.exit(main())
