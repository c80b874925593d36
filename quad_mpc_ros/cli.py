"""The command line ``quad_mpc``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from quad_mpc_ros import __version__
from quad_mpc_ros.configuration import UserError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 failsafe or failure, 2 bad input."""
    options = _parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    # Options first: importing the commands brings in what they need, which takes a moment.
    from quad_mpc_ros.commands.bag_options import add_bag_commands, add_replay_options
    from quad_mpc_ros.commands.bench_options import add_bench_options
    from quad_mpc_ros.commands.check_reference import add_check_options
    from quad_mpc_ros.commands.recording_options import add_identify_options, add_resolve_options
    from quad_mpc_ros.commands.run_options import add_run_options

    parser = argparse.ArgumentParser(
        prog="quad_mpc",
        description="Model predictive control of a quadrotor on SO(3).",
        epilog="Every command explains itself: quad_mpc COMMAND --help.",
    )
    parser.add_argument("--version", action="version", version=f"quad_mpc {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    fly = commands.add_parser(
        "fly",
        help="fly over DDS: simulator, reference, mpc and recorder as processes of their own",
        description="Start simulator, reference, mpc and recorder as separate ROS 2 processes, "
        "fly, stop them, and write DIR/bag (rosbag2, MCAP), DIR/summary.json, DIR/figures/*.png "
        "and DIR/log. Exit code 0 only for a flight without failsafe, 2 for bad input.",
    )
    add_run_options(fly)
    fly.add_argument(
        "--lockstep",
        action="store_true",
        help="simulated time that waits for every command: repeatable bit for bit",
    )
    fly.set_defaults(run=_fly)

    simulate = commands.add_parser(
        "simulate",
        help="fly the same in one process without ROS, faster than real time",
        description="Fly the closed loop in one process, without ROS. Writes the same files as "
        "'fly'; the commands are those of 'fly --lockstep', bit for bit.",
    )
    add_run_options(simulate)
    simulate.set_defaults(run=_simulate)

    bench = commands.add_parser(
        "bench",
        help="measure this controller beside acados, cvxpy and OSQP's own time",
        description="Fly the square on the true rigid body with each peer in turn, in one "
        "process, and tell what a step costs: this controller, acados (SQP_RTI, HPIPM), the same "
        "QP through cvxpy rebuilt at every step, and the solvers' own times; then the cost "
        "against the length of the horizon. The peers are optional: pip install "
        "'quad_mpc_ros[bench]'. Exit code 2 for bad input.",
    )
    add_bench_options(bench)
    bench.set_defaults(run=_bench)

    check = commands.add_parser(
        "check-reference",
        help="judge a reference before it is flown: throttle and body rates against the limits",
        description="Print and draw what a reference needs along its whole way against the "
        "vehicle's limits. Exit code 0 when it is feasible, 1 when it is not, 2 for bad input.",
    )
    add_check_options(check)
    check.set_defaults(run=_check_reference)
    identify = commands.add_parser(
        "identify",
        help="fit lags, delay, thrust and drag of the vehicle to a recorded flight",
        description="Fit the lags of body rates and thrust, the input delay, the thrust per mass "
        "and the drag to the commands and the odometry of a flight. Prints a ROS parameter file "
        "for --config on standard output, and what was found with its 95 %% intervals on standard "
        "error.",
    )
    add_identify_options(identify)
    identify.set_defaults(run=_identify)

    resolve = commands.add_parser(
        "resolve",
        help="feed a recorded flight to the controller: what would it have commanded?",
        description="Feed the recorded odometry and reference to the controller, without ROS, and "
        "compare its commands with the recorded ones. With the recorded parameters, which are the "
        "default, they are the same; --config and --set ask what others would have commanded. "
        "Writes DIR/bag, DIR/summary.json and DIR/figures/commands.png.",
    )
    add_resolve_options(resolve)
    resolve.set_defaults(run=_resolve)
    replay = commands.add_parser(
        "replay",
        help="publish a recorded bag again",
        description="Publish the messages of a bag on their topics again, in the time in which "
        "they were recorded. Pause and go on by the services /player/pause and /player/resume. "
        "Exit code 2 for a bag that cannot be played.",
    )
    add_replay_options(replay)
    replay.set_defaults(run=_replay)

    bag = commands.add_parser("bag", help="look into a bag, or repair one")
    add_bag_commands(bag)
    bag.set_defaults(run=_bag)
    return parser


def _fly(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.fly import fly

    return fly(options)


def _check_reference(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.check_reference import check_reference

    return check_reference(options)


def _simulate(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.simulate import simulate

    return simulate(options)


def _bench(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.bench import bench

    return bench(options)


def _identify(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.identify import identify_command

    return identify_command(options)


def _resolve(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.resolve import resolve_command

    return resolve_command(options)


def _replay(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.replay import replay

    return replay(options)


def _bag(options: argparse.Namespace) -> int:
    from quad_mpc_ros.commands.bag import bag

    return bag(options)


if __name__ == "__main__":
    sys.exit(main())
