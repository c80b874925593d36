# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly PX4 SITL with ``tools/fly_px4.py`` from take-off to landing.

At half the speed of the wall clock, so that a busy machine keeps up.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
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
        "omega_max": RATES,
        "takeoff_height": 2.5,
        "height": 2.5,
    },
}
PX4 = {
    "COM_RC_IN_MODE": "4",  # no stick input
    "NAV_DLL_ACT": "0",
    "COM_DISARM_PRFLT": "-1",
    "UXRCE_DDS_SYNCT": "0",  # stamps by its own time
}

Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture(scope="session", autouse=True)
def _compiled() -> None:
    """The flights are one process each, and with MAVLink they need no installed ROS 2."""


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


def start_px4(build: Path, start: Start, folder: Path, **more: str) -> int:
    """Start it and return its instance, beside others on this machine: ports, a lock in /tmp."""
    instance = int(os.environ["ROS_DOMAIN_ID"])
    simulated = {
        "PX4_SIM_MODEL": "sihsim_quadx",
        "PX4_SIM_SPEED_FACTOR": "0.5",
        **{f"PX4_PARAM_{name}": value for name, value in PX4.items()},
        **more,
    }
    files = [str(build / "etc"), "-s", "etc/init.d-posix/rcS", "-w", str(folder)]
    command = [str(build / "bin/px4"), "-d", *files, "-i", str(instance)]
    start("px4", command, {**os.environ, **simulated})
    return instance


def flown(
    start: Start,
    folder: Path,
    bridge: str,
    *options: str,
    python: str,
    env: Mapping[str, str],
    **parameters: Any,
) -> dict[str, list[float]]:
    """Fly with the tool and a bridge of these parameters; return its table, a row a phase."""
    nodes = {**CONFIG, f"{bridge}_bridge": {**VEHICLE, **parameters}}
    config = folder / "sih.yaml"
    parameters_of = {f"/**/{name}": {"ros__parameters": each} for name, each in nodes.items()}
    config.write_text(json.dumps(parameters_of))  # YAML, without aliases of what is shared
    command = [python, "-P", str(TOOL), "--config", str(config), "--bridge", bridge, *options]
    code = start("flight", command, dict(env)).wait()
    log = (folder / "flight.log").read_text()
    assert code == 0, log + (folder / "px4.log").read_text()[-3000:]
    assert "disarmed by itself" in log, log
    print(log)  # shown if a bound below fails
    lines = log[log.index("phase  ") :].splitlines()[1:]
    table = {line[:12].strip(): [float(each) for each in line[12:].split()] for line in lines}
    for phase, row in table.items():
        assert phase == "ground" or row[-1] < 10.0  # in per cent: not the MPC
        assert phase in ("take off", "reference") or row[3] < 30  # degrees
    return table


def start_px4_with_agent(
    build: Path, start: Start, folder: Path
) -> tuple[int, dict[str, str], dict[str, Any]]:
    """Start PX4 with its agent; return the instance, the environment and px4_bridge's parameters.

    Skips the test without px4_msgs or agent.
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
    port = str(free_port())
    start("agent", [agent, "udp4", "-p", port], env)
    instance = start_px4(build, start, folder, PX4_UXRCE_DDS_PORT=port)
    return instance, env, {"fmu": f"/px4_{instance}/fmu", "target_system": instance + 1}


@pytest.mark.timeout(400)
@pytest.mark.parametrize("mode", ["offboard", "external"])
def test_px4_is_flown_from_the_ground_to_the_ground(
    build: Path, start: Start, tmp_path: Path, mode: str
) -> None:
    """Engaged on the ground, armed, a short hover, landed, and disarmed by PX4 itself."""
    _, env, vehicle = start_px4_with_agent(build, start, tmp_path)
    table = flown(
        start, tmp_path, "px4", "--short", python="python3", env=env, mode=mode, **vehicle
    )
    mean, largest, _, tilt, *_ = table["hover"]
    assert mean < 0.3 and largest < 0.6
    assert tilt < 30


@pytest.mark.timeout(900)
def test_px4_is_flown_by_mavlink(build: Path, start: Start, tmp_path: Path) -> None:
    """The whole flight: hover, lemniscate, corners. Needs rclpy, but no agent and no px4_msgs."""
    pytest.importorskip("rclpy")
    pytest.importorskip("pymavlink")
    instance = start_px4(build, start, tmp_path)
    device = f"udpout:127.0.0.1:{14580 + instance}"
    table = flown(start, tmp_path, "mavlink", python=sys.executable, env=os.environ, device=device)
    for phase, most in {"hover": 0.15, "reference": 0.15, "corner 4": 0.2}.items():
        assert table[phase][0] < most
    assert table["reference"][2] > 4.0  # m/s


MODE_IS_UNRESPONSIVE = 9815168
"""Number of this event in the metadata of PX4, build/px4_sitl_default/events."""


def events_in(data: bytes) -> set[int]:
    """Return the numbers of the events of the autopilot in whole frames of MAVLink 2.

    pymavlink has no EVENT (410), whose payload begins with the number in 24 bits.
    """
    found = set()
    while len(data) > 12 and data[0] == 0xFD:
        if int.from_bytes(data[7:10], "little") == 410:
            found.add(int.from_bytes(data[10:13], "little"))
        data = data[12 + data[1] :]
    return found


class Connection:
    """A bridge to PX4 by MAVLink, without a node."""

    def __init__(self, device: str) -> None:
        from quad_mpc_ros.ros.bridges.mavlink import MavlinkBridge
        from quad_mpc_ros.ros.messages import new_message

        self.bridge = MavlinkBridge(MavlinkBridge.Config(device=device), new_message)
        assert self.bridge.line is not None
        self._line = self.bridge.line
        self.received, self.events = b"", set[int]()

    def until(
        self,
        condition: Callable[[], Any],
        *,
        seconds: float = 60.0,
        ask: tuple[Any, ...] | None = None,
    ) -> Any:
        """Exchange messages until a condition is true; return what it returned.

        ``ask`` is a command, and its parameters, that is sent every second.
        """
        deadline, asked = time.monotonic() + seconds, 0.0
        while not (found := condition()):
            assert time.monotonic() < deadline, self.bridge.take_warnings()
            if ask is not None and time.monotonic() - asked > 1.0:
                asked = time.monotonic()
                self.command(*ask)
            data = self._line.read()
            self.received = self.received[-65536:] + data
            self.events |= events_in(data)
            self._line.write(self.bridge.exchange(data, now_ns=self.now_ns))
            time.sleep(0.002)
        return found

    def close(self) -> None:
        self._line.close()

    @property
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def command(self, number: int, *parameters: float) -> None:
        """Send a COMMAND_LONG, as a ground station does."""
        message = self.bridge._command(number, *parameters)
        self._line.write(self.bridge._packed(message))

    def arm(self, wanted: bool) -> Any:
        """Return how PX4 answers a request to arm or disarm."""
        response = self.bridge.arm(wanted, now_ns=self.now_ns)
        for each in response.messages:
            self._line.write(each)
        return self.until(lambda: self.bridge.arming_outcome(now_ns=self.now_ns))


@pytest.mark.timeout(200)
def test_px4_gives_its_reason_and_disarms_in_the_air(
    build: Path, start: Start, tmp_path: Path
) -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("pymavlink")
    instance = start_px4(build, start, tmp_path)
    with closing(Connection(f"udpout:127.0.0.1:{14580 + instance}")) as px4:
        bridge = px4.bridge
        px4.until(lambda: not bridge.stack_fault(now_ns=px4.now_ns))
        while not (outcome := px4.arm(True)).accepted:  # until its estimator has started
            assert "the autopilot refuses arming: temporarily rejected" in outcome.text
        px4.command(22, 0.0, 0.0, 0.0, *4 * [float("nan")])  # take off
        px4.until(lambda: bridge.landed(now_ns=px4.now_ns) is False)
        # PX4 refuses to disarm in the air, unless it is forced.
        px4.command(400, 0.0, 0.0)
        denied = "the autopilot reports: Disarming denied: not landed"
        px4.until(lambda: denied in bridge.take_warnings())
        outcome = px4.arm(False)
        assert (outcome.accepted, outcome.text) == (True, "disarmed")


@pytest.mark.timeout(200)
def test_px4_refuses_arming_with_the_reason_of_the_mode(
    build: Path, start: Start, tmp_path: Path
) -> None:
    """The ground station selects the mode quad MPC, for which no MPC runs."""
    pytest.importorskip("pymavlink")
    instance, env, vehicle = start_px4_with_agent(build, start, tmp_path)
    parameters = {**vehicle, "mode": "external"}
    arguments = [part for name in parameters for part in ("-p", f"{name}:={parameters[name]}")]
    script = "import sys; from quad_mpc_ros.entry import px4_bridge; sys.exit(px4_bridge())"
    start("bridge", ["python3", "-P", "-c", script, "--ros-args", *arguments], env)
    with closing(Connection(f"udpout:127.0.0.1:{14580 + instance}")) as px4:
        px4.until(lambda: not px4.bridge.stack_fault(now_ns=px4.now_ns))
        px4.until(lambda: b"quad MPC" in px4.received, ask=(512, 435.0, 0.0))  # AVAILABLE_MODES
        external = 11  # sub mode EXTERNAL1
        px4.until(lambda: px4.bridge._mode >> 24 == external, ask=(176, 1.0, 4.0, 11.0))
        outcome = px4.arm(True)
        assert not outcome.accepted
        denied = "the autopilot reports: Arming denied: Resolve system health failures first"
        px4.until(lambda: denied in px4.bridge.take_warnings())
        px4.until(lambda: MODE_IS_UNRESPONSIVE in px4.events)
    assert "there is no fresh command" in (tmp_path / "bridge.log").read_text()
