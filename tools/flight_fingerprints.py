# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Digests of the commands of many flights, to show that a change alters none of them by a bit.

    python -P tools/flight_fingerprints.py before.txt    # in one environment
    python -P tools/flight_fingerprints.py after.txt     # in the other
    diff before.txt after.txt

Flies through the command line, with both formulations, lags, delays, noise, wind, limits and most
references, two flights in lockstep over DDS, and in one process every fault of
test/fixtures/faults that needs no wall clock. Which package flies is up to the Python that runs
this. Digests compare on one machine only: another one may compile the same sums in another order.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

from mcap.reader import make_reader

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.config import SimulatorConfig

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from fixtures.faults.cases import FAULTS, Fault
from fixtures.faults.flight import FaultFlight

QUAD_MPC = (sys.executable, "-P", "-m", "quad_mpc_ros.cli")

LAGS = ("rate_time_constant=0.03", "thrust_time_constant=0.03")
MODELLED = [f"{node}.{lag}" for node in ("mpc", "simulator") for lag in LAGS]
DELAYED = [*MODELLED, "mpc.input_delay=0.02", "simulator.command_delay=0.02"]
NOISE = [
    "simulator.position_noise=0.01",
    "simulator.attitude_noise=0.01",
    "simulator.velocity_noise=0.05",
    "simulator.rate_noise=0.02",
    "simulator.seed=7",
]

# name: options, assignments
SIMULATED: dict[str, tuple[list[str], list[str]]] = {
    "square": ([], []),
    "paper": (["--config", "paper"], []),
    "paper_rigid_body": (["--config", "paper_rigid_body"], []),
    "lemniscate_lags": (
        ["--reference", "lemniscate"],
        [*DELAYED, "reference.angular_frequency=2.6"],
    ),
    "lemniscate_unknown": (
        ["--reference", "lemniscate"],
        [*NOISE, "simulator.wind=[3.0, -2.0, 0.5]", "simulator.mass_scale=1.1"],
    ),
    "square_lags_noise": ([], [*DELAYED, *NOISE]),
    "flip": (["--reference", "flip"], MODELLED),
    "vertical_loop": (["--reference", "vertical_loop"], DELAYED),
    "minimum_snap": (["--reference", "minimum_snap"], ["mpc.estimate_disturbance=false"]),
    "hover_losses": (
        ["--reference", "hover"],
        [*NOISE, "simulator.odom_dropout=0.2", "simulator.odom_rate=200.0"],
    ),
    "fast_control": (
        ["--reference", "circle"],
        ["mpc.control_rate=100.0", "simulator.odom_rate=200.0", "mpc.horizon_steps=20"],
    ),
    "limits": (
        ["--reference", "lemniscate", "--start", "ground"],
        [
            "mpc.fence.maximum=[2.0, 9.0, 9.0]",
            "mpc.envelope.speed_max=4.0",
        ],
    ),
    "soft_limits": (
        ["--reference", "lemniscate"],
        [
            "reference.angular_frequency=1.8",
            "mpc.limits.tilt_max=0.5",
            "mpc.limits.speed_max=4.0",
        ],
    ),
    "contouring": (
        ["--reference", "lemniscate"],
        [*DELAYED, "mpc.formulation=contouring", "reference.angular_frequency=2.0"],
    ),
    "gusts_paper": (
        ["--config", "paper_rigid_body", "--reference", "circle"],
        ["simulator.wind=[2.0, 1.0, 0.0]", "simulator.gust_intensity=1.0"],
    ),
    "racer": (
        ["--config", "agile", "--config", "vehicles/racer", "--reference", "lemniscate"],
        ["simulator.gust_intensity=1.0", "simulator.battery.capacity=1.55"],
    ),
    "rotorpy": (["--plant", "rotorpy", "--reference", "lemniscate", "--duration", "5"], []),
}
OVER_DDS: dict[str, tuple[list[str], list[str]]] = {
    "dds_lockstep_square": (["--lockstep", "--duration", "10"], []),
    "dds_lockstep_lemniscate": (
        ["--lockstep", "--duration", "6", "--reference", "lemniscate"],
        [*DELAYED, *NOISE],
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path, help="file of digests to write, a line a flight")
    parser.add_argument(
        "--only", nargs="+", metavar="FLIGHT", help=f"of {', '.join(names())} (default: all)"
    )
    options = parser.parse_args()
    unknown = set(options.only or ()) - set(names())
    if unknown:
        parser.error(f"--only: given {', '.join(sorted(unknown))}, expected some of {names()}")
    lines = []
    for name in options.only or names():
        lines.append(fingerprint(name))
        print(lines[-1], flush=True)
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


def names() -> list[str]:
    """Return the names of all flights."""
    return [*SIMULATED, *OVER_DDS, *(f"fault_{name}" for name in FAULTS)]


def fingerprint(name: str) -> str:
    """Fly, and return name, number of commands and their digest as a line."""
    if name in SIMULATED:
        return line(name, *flown("simulate", *SIMULATED[name]))
    if name in OVER_DDS:
        return line(name, *flown("fly", *OVER_DDS[name]))
    return line(name, *flown_with(FAULTS[name.removeprefix("fault_")]))


def line(name: str, count: int, digest: str) -> str:
    return f"{name:32} {count:6d} {digest}"


def flown(command: str, arguments: list[str], assignments: list[str]) -> tuple[int, str]:
    """Fly by the command line; return the number and the digest of the commands in the bag."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        sets = [word for assignment in assignments for word in ("--set", assignment)]
        ended = subprocess.run(
            [*QUAD_MPC, command, *arguments, *sets, "--out", str(out)],
            capture_output=True,
            text=True,
            check=False,
        )
        if not (out / "summary.json").exists():  # a flight with a fallback is one, too
            raise SystemExit(f"{arguments} {assignments}: {ended.stdout}{ended.stderr}")
        digest, count = hashlib.sha256(), 0
        for file in sorted((out / "bag").glob("*.mcap")):
            with file.open("rb") as stream:
                # Their bytes only: over DDS the log times are of the wall clock.
                for *_, message in make_reader(stream).iter_messages(topics=["/command"]):
                    digest.update(message.data)
                    count += 1
        return count, digest.hexdigest()[:32]


def flown_with(fault: Fault) -> tuple[int, str]:
    """Fly with a fault; return the number and the digest of the commands, and their sources."""
    if fault.grounded:
        simulator = SimulatorConfig(position_bias=(0.0, 0.0, 0.5))
        reference = ReferenceConfig(trajectory="hover", height=0.0)
    else:
        simulator = SimulatorConfig(initial_position=(0.0, 0.0, 10.0), initial_throttle=0.3)
        reference = ReferenceConfig(trajectory="lemniscate", height=10.0)
    flight = FaultFlight(fault, mpc=MpcConfig(), simulator=simulator, reference=reference)
    flight.run()
    digest, count, sources = hashlib.sha256(), 0, set()
    for time_ns, tick in flight.ticks:
        sources.add(tick.decision.source.name)
        if tick.command is not None:
            rates = tick.command.w_WB_B.tolist()
            digest.update(f"{time_ns} {tick.command.throttle!r} {rates!r}".encode())
            count += 1
    return count, f"{digest.hexdigest()[:32]} {','.join(sorted(sources))}"


if __name__ == "__main__":
    main()
