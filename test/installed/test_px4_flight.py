"""PX4 itself, in its own simulation, flown by ``tools/fly_px4.py`` from ground to ground."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from fixtures.installed_ros import environment, importable

BUILD = "QUAD_MPC_PX4"
"""Names a build of PX4 for simulation, as PX4-Autopilot/build/px4_sitl_default."""

TOOL = Path(__file__).parents[2] / "tools" / "fly_px4.py"
# Of sihsim_quadx: 1 kg, four motors of 5 N, linear. The lags are guessed.
VEHICLE = {
    "mass": 1.0,
    "thrust_curve": [0.0, 5.0, 0.0],
}
LAGS = {"rate_time_constant": 0.12, "thrust_time_constant": 0.05, "input_delay": 0.045}
RATES = [3.8, 3.8, 3.4]
CONFIG = {
    "mpc": {**VEHICLE, "drag": 1.0, **LAGS, "omega_max": RATES},
    "reference": {
        **VEHICLE,
        "drag": 1.0,
        "advanced.trajectory_omega_max": RATES,
        "takeoff_height": 2.5,
        "height": 2.5,
    },
    "px4_bridge": VEHICLE,
}
PX4 = {
    "COM_OF_LOSS_T": "1.0",  # of its own time, which runs at half the speed
    "COM_RC_IN_MODE": "4",  # nobody steers
    "NAV_DLL_ACT": "0",
    "COM_DISARM_PRFLT": "-1",
    "UXRCE_DDS_SYNCT": "0",  # stamps by its own time
}

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def build() -> Path:
    """Return the folder of the build; skip the test where there is none."""
    named = os.environ.get(BUILD)
    if not named:
        pytest.skip(f"no PX4: name a build of it for simulation in {BUILD}")
    return Path(named).resolve()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start processes with a group of their own and a log; all end with the test."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(name: str, command: list[str], env: dict[str, str]) -> subprocess.Popen[bytes]:
        with (tmp_path / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                command,
                cwd=tmp_path,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        started.append(process)
        return process

    yield begin
    for number in (signal.SIGTERM, signal.SIGKILL):
        for process in started:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, number)
        time.sleep(0.5)
    for process in started:
        process.wait()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.timeout(400)
def test_px4_is_flown_from_the_ground_to_the_ground(
    build: Path, start: Start, tmp_path: Path
) -> None:
    """Engaged on the ground, armed, a short hover, landed, and disarmed by PX4 itself.

    At half the speed of the wall clock, so that a busy machine keeps up.
    """
    env = environment()
    if not importable("px4_msgs.msg.VehicleOdometry"):
        pytest.skip("no px4_msgs")
    env = {**env, "PATH": f"{build / 'bin'}:{env['PATH']}"}
    libraries = [str(build / "bin"), env.get("LD_LIBRARY_PATH", "")]
    env["LD_LIBRARY_PATH"] = ":".join(each for each in libraries if each)
    agent = shutil.which("MicroXRCEAgent", path=env["PATH"])
    if agent is None:
        pytest.skip("no MicroXRCEAgent")
    port = free_port()
    start("agent", [agent, "udp4", "-p", str(port)], env)
    # An instance of its own beside others on this machine: ports, and a lock in /tmp.
    instance = os.environ["ROS_DOMAIN_ID"]
    simulated = {
        "PX4_SIM_MODEL": "sihsim_quadx",
        "PX4_SIM_SPEED_FACTOR": "0.5",
        "PX4_UXRCE_DDS_PORT": str(port),
        **{f"PX4_PARAM_{name}": value for name, value in PX4.items()},
    }
    files = [str(build / "etc"), "-s", "etc/init.d-posix/rcS", "-w", str(tmp_path)]
    start("px4", [str(build / "bin/px4"), "-d", *files, "-i", instance], {**env, **simulated})

    config = tmp_path / "sih.yaml"
    nodes = {
        **CONFIG,
        "px4_bridge": {
            **CONFIG["px4_bridge"],
            "fmu": f"/px4_{instance}/fmu",
            "target_system": int(instance) + 1,
        },
    }
    config.write_text(
        yaml.safe_dump({f"/**/{name}": {"ros__parameters": each} for name, each in nodes.items()})
    )
    command = ["python3", "-P", str(TOOL), "--short", "--config", str(config)]
    pilot = start("flight", command, env)
    code = pilot.wait()
    told = (tmp_path / "flight.log").read_text()
    assert code == 0, told + (tmp_path / "px4.log").read_text()[-3000:]
    assert "disarmed by itself" in told, told
    phases = {line.split("  ")[0]: line.split()[-10:] for line in told.splitlines()}
    mean, largest, _, tilt, *_ = map(float, phases["hover"])
    assert mean < 0.3 and largest < 0.6, told
    assert tilt < 30, told
    for name in ("take off", "hover", "land"):
        assert float(phases[name][-1]) < 10.0, told  # in per cent: not the MPC
