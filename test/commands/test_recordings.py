# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc resolve`` and ``quad_mpc identify`` on valid and invalid bags."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.bag_payloads import payloads
from fixtures.messages import empty, encoded_by_rosbags
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.recordings.parameters import read_parameters, write_parameters
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.writer import BagWriter

ODOMETRY = "nav_msgs/msg/Odometry"
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
# Lags, delay and disturbance in the model: the commands then depend on those sent before.
LAGGED = (
    "mpc.formulation=manifold",
    "mpc.terminal_weight=30",
    "mpc.rate_time_constant=0.03",
    "mpc.thrust_time_constant=0.04",
    "mpc.input_delay=0.02",
    "mpc.estimate_disturbance=true",
    "simulator.rate_time_constant=0.03",
    "simulator.thrust_time_constant=0.04",
    "simulator.command_delay=0.02",
    "simulator.mass_scale=1.2",
)


WITH_IMU = (
    *LAGGED,
    "mpc.advanced.accelerometer_noise=0.5",
    "simulator.imu_rate=200",
    "simulator.imu_noise=0.3",
    "simulator.velocity_noise=0.1",
)


def simulated(out: Path, *assignments: str, duration: float) -> Path:
    sets = [part for assignment in assignments for part in ("--set", assignment)]
    code = main(["simulate", *sets, "--duration", str(duration), "--out", str(out)])
    assert code == 0
    return out


@pytest.fixture(scope="module")
def square(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("square") / "run"
    return simulated(out, "mpc.formulation=paper", duration=3.0)


@pytest.fixture(scope="module")
def lagged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("lagged") / "run", *LAGGED, duration=8.0)


@pytest.fixture(scope="module")
def with_imu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("with_imu") / "run", *WITH_IMU, duration=4.0)


def resolved(bag: Path, out: Path, *arguments: str) -> dict[str, Any]:
    assert main(["resolve", str(bag), *arguments, "--out", str(out)]) == 0
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


@pytest.mark.parametrize("flight", ["square", "lagged", "with_imu"])
def test_recorded_configuration_reproduces_the_commands(
    flight: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    run: Path = request.getfixturevalue(flight)
    summary = resolved(run, tmp_path / "again")
    before = payloads(run / "bag")
    assert payloads(tmp_path / "again" / "bag") == before
    assert payloads(tmp_path / "again" / "bag", "/recorded_command") == before
    assert summary["equal"] == summary["compared"] == len(before)
    assert (tmp_path / "again/figures/commands.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_imu_samples_are_recorded_and_change_the_commands(with_imu: Path, tmp_path: Path) -> None:
    assert len(payloads(with_imu / "bag", "/imu")) == 4 * (
        len(payloads(with_imu / "bag", "/odom")) - 1
    )
    without_imu = resolved(
        with_imu, tmp_path / "without_imu", "--set", "mpc.advanced.accelerometer_noise=0"
    )
    assert without_imu["equal"] < 0.5 * without_imu["compared"]
    again = resolved(tmp_path / "without_imu", tmp_path / "again", "--set", WITH_IMU[len(LAGGED)])
    assert again["equal"] == again["compared"]


def test_resolves_without_imu_if_the_bag_has_no_imu(
    lagged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = resolved(lagged, tmp_path / "again", "--set", WITH_IMU[len(LAGGED)])
    assert summary["equal"] == summary["compared"] > 0
    assert "no imu in the recording" in capsys.readouterr().err


def test_simulate_rejects_accelerometer_noise_without_imu(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "run")]
    assert main(["simulate", "--set", WITH_IMU[len(LAGGED)], *out]) == 2
    assert "simulator.imu_rate: given 0.0" in capsys.readouterr().err


def test_another_configuration_is_reported_and_kept(square: Path, tmp_path: Path) -> None:
    out = tmp_path / "heavy"
    summary = resolved(square, out, "--set", "mpc.mass=0.5", "--set", "mpc.horizon_steps=15")
    assert summary["equal"] < 20  # but where both are at a bound
    assert summary["difference"]["throttle"]["rms"] > 0.01
    parameters = read_parameters(BagReader(out / "bag").metadata)
    assert parameters["mpc"]["mass"] == 0.5
    assert parameters["mpc"]["horizon_steps"] == 15
    # What the vehicle did stays as it was flown, and is what the new bag is compared with.
    again = resolved(out, tmp_path / "again")
    assert again["difference"] == summary["difference"]
    assert payloads(tmp_path / "again" / "bag") == payloads(out / "bag")


def test_recorded_commands_remain_the_command_history(lagged: Path, tmp_path: Path) -> None:
    """A controller with other weights must not assume that its own commands were flown.

    If it did, its estimate of the disturbance would take the difference for wind.
    """
    out = tmp_path / "gentle"
    resolved(lagged, out, "--set", "mpc.R=[0.0, 0.1, 0.1, 0.1]")

    def scales(bag: Path) -> np.ndarray:
        reader = BagReader(bag)
        return np.array(
            [
                float(pair.value)
                for message in reader.messages(["/mpc/stats"])
                for pair in message.message.status[0].values
                if pair.key == "thrust_scale"
            ]
        )

    assert np.array_equal(scales(out / "bag"), scales(lagged / "bag"))
    assert payloads(out / "bag") != payloads(lagged / "bag")


def rewritten(
    run: Path,
    bag: Path,
    change: Callable[[Any, str], list[tuple[str, str, Any]]],
    *,
    parameters: bool = True,
) -> Path:
    """Rewrite a bag; ``change`` returns the new topic, type and message of each message."""
    reader = BagReader(run / "bag")
    written: list[tuple[str, str, Any, int, int]] = []
    for recorded in reader.messages():
        for topic, type_name, message in change(recorded.message, recorded.topic):
            written.append(
                (topic, type_name, message, recorded.log_time_ns, recorded.publish_time_ns)
            )
    with BagWriter(bag) as writer:
        for topic, type_name in sorted({(topic, kind) for topic, kind, *_ in written}):
            writer.add_topic(topic, type_name)
        for topic, kind, message, log_ns, publish_ns in written:
            data = encoded_by_rosbags(kind, message)
            writer.write(topic, data, log_time_ns=log_ns, publish_time_ns=publish_ns)
        if parameters:
            for node, values in read_parameters(reader.metadata).items():
                write_parameters(writer, node, values)
    return bag


def test_odometry_of_another_stack_with_a_twist_in_the_world_frame(
    square: Path, tmp_path: Path
) -> None:
    def change(message: Any, topic: str) -> list[tuple[str, str, Any]]:
        if topic == "/reference":
            return [("/planner/window", "trajectory_msgs/msg/MultiDOFJointTrajectory", message)]
        if topic == "/command":
            return [("/rates", TWIST, message)]
        if topic != "/odom":
            return []
        q, linear = message.pose.pose.orientation, message.twist.twist.linear
        R_WB = so3.rotation_from_quaternion_xyzw(np.array([q.x, q.y, q.z, q.w]))
        world = R_WB @ [linear.x, linear.y, linear.z]
        angular = message.twist.twist.angular
        turn = R_WB @ [angular.x, angular.y, angular.z]
        for name, x, y in zip("xyz", world.tolist(), turn.tolist(), strict=True):
            setattr(linear, name, x)
            setattr(angular, name, y)
        return [("/local/state", ODOMETRY, message)]

    bag = rewritten(square, tmp_path / "other", change)
    mapping = ["--odom-topic", "local/state"]
    mapping += ["--reference-topic", "/planner/window", "--command-topic", "/rates"]
    summary = resolved(bag, tmp_path / "out", *mapping, "--set", "mpc.odometry.twist_frame=world")
    assert summary["compared"] == 150
    for channel in summary["difference"].values():
        assert channel["max"] < 1e-6
    wrong = resolved(bag, tmp_path / "wrong", *mapping)
    assert wrong["difference"]["rate_y"]["max"] > 1.0


def test_a_bag_without_reference_and_parameters(
    square: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def change(message: Any, topic: str) -> list[tuple[str, str, Any]]:
        if topic != "/odom":
            return []
        message.header.frame_id = "map"
        return [("/vehicle/state", ODOMETRY, message)]

    bag = rewritten(square, tmp_path / "other", change, parameters=False)
    assert main(["resolve", str(bag), "--odom-topic", "/vehicle/state"]) == 2
    assert "--reference NAME" in capsys.readouterr().err
    arguments = ["--odom-topic", "/vehicle/state", "--reference", "square"]
    arguments += ["--set", "mpc.formulation=paper"]
    summary = resolved(bag, tmp_path / "out", *arguments)
    assert summary["compared"] == summary["only_recorded"] == 0
    assert "'map'" in capsys.readouterr().err
    # The same reference at the same odometry: what the flight was commanded.
    assert summary["only_resolved"] == 150
    new, old = (_throttles(path / "bag") for path in (tmp_path / "out", square))
    assert new == pytest.approx(old, abs=1e-9)


def _throttles(bag: Path) -> list[float]:
    return [message.message.twist.linear.z for message in BagReader(bag).messages(["/command"])]


def _truncated(run: Path, path: Path) -> None:
    data = next((run / "bag").glob("*.mcap")).read_bytes()
    path.write_bytes(data[:300])


def _flipped(run: Path, path: Path) -> None:
    """Overwrite the middle of the first chunk: nothing reads between chunks."""
    data = bytearray(next((run / "bag").glob("*.mcap")).read_bytes())
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[0]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    data[middle : middle + 100] = bytes(100)
    path.write_bytes(data)


def _bad_parameters(run: Path, path: Path) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/odom", ODOMETRY)
        writer.write_metadata("parameters:mpc", {"yaml": "mpc: ["})
        writer.write("/odom", empty(ODOMETRY), log_time_ns=1, publish_time_ns=1)


def _wrong_type(run: Path, path: Path) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/odom", POSE)
        writer.write("/odom", empty(POSE), log_time_ns=1, publish_time_ns=1)


def _nonsense(run: Path, path: Path) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/odom", ODOMETRY)
        writer.write("/odom", b"\x00\x01\x00\x00nonsense", log_time_ns=1, publish_time_ns=1)


def _no_messages(run: Path, path: Path) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/odom", ODOMETRY)


def _standing_stamps(run: Path, path: Path) -> None:
    def change(message: Any, topic: str) -> list[tuple[str, str, Any]]:
        if topic == "/odom":
            message.header.stamp.sec = message.header.stamp.nanosec = 0
            return [(topic, ODOMETRY, message)]
        return []

    rewritten(run, path, change)


# Those that the tests of every wrong input to a command do not make.
BAD_BAGS: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "truncated": (_truncated, "is unfinished; complete it: quad_mpc bag repair"),
    "bytes overwritten": (_flipped, "corrupt"),
    "no stamps": (_standing_stamps, "odometry stamps do not advance: given 150 odometries with 1"),
    "no messages": (_no_messages, "no odometry"),
    "wrong type": (_wrong_type, "/odom (geometry_msgs/msg/PoseStamped)"),
    "nonsense in a message": (_nonsense, "cannot decode"),
    "nonsense for parameters": (_bad_parameters, "parameters:mpc"),
}


@pytest.mark.parametrize("command", ["resolve", "identify"])
@pytest.mark.parametrize("kind", BAD_BAGS)
def test_invalid_bag_is_one_line_and_exit_code_2(
    command: str, kind: str, square: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, expected = BAD_BAGS[kind]
    bag, out = tmp_path / "bag.mcap", tmp_path / "out"
    make(square, bag)
    capsys.readouterr()
    assert main([command, str(bag), "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert expected in printed.err
    assert len(printed.err.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("command", "arguments", "expected"),
    [
        ("resolve", ["--odom-topic", "/nowhere"], "/nowhere"),
        ("resolve", ["--odom-topic", "/command"], "expected nav_msgs/msg/Odometry"),
        ("identify", ["--battery-topic", "/odom"], "expected sensor_msgs/msg/BatteryState or"),
        ("identify", ["--battery-topic", "/none"], "topic /none is not in the bag"),
    ],
)
def test_rejects_wrong_options(
    command: str,
    arguments: list[str],
    expected: str,
    square: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([command, str(square), *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert len(error.strip().splitlines()) == 1


def test_a_flight_too_short_to_identify(square: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", str(square)]) == 2
    assert "longer flight" in capsys.readouterr().err


def test_the_identified_file_is_accepted_by_config(
    lagged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = tmp_path / "vehicle.yaml"
    assert main(["identify", str(lagged), "--out", str(vehicle)]) == 0
    capsys.readouterr()
    summary = resolved(lagged, tmp_path / "out", "--config", str(vehicle))
    mpc = summary["config"]["mpc"]
    assert mpc["rate_time_constant"] == pytest.approx([0.03, 0.03, 0.03], rel=0.1)
    assert mpc["thrust_time_constant"] == pytest.approx(0.04, rel=0.1)
    assert mpc["input_delay"] == pytest.approx(0.02, rel=0.1)
    assert mpc["thrust_curve"][1] / 2.79829004 == pytest.approx(1.0 / 1.2, rel=0.1)


def test_a_battery_is_simulated_recorded_and_identified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    sets = ["simulator.battery.capacity=0.004", "simulator.velocity_noise=0.02"]
    options = [part for each in sets for part in ("--set", each)]
    flight = ["--plant", "rotors", "--reference", "excitation", "--duration", "16"]
    assert main(["simulate", *flight, *options, "--out", str(out)]) == 0
    with AnyReader([out / "bag"]) as reader:
        (battery,) = (c for c in reader.connections if c.topic == "/battery")
        assert battery.msgtype == "sensor_msgs/msg/BatteryState"
        assert battery.msgcount == 16 * 5
        volts = [
            float(reader.deserialize(data, battery.msgtype).voltage)
            for _, _, data in reader.messages([battery])
        ]
    assert volts[0] > volts[-1] + 1.0
    capsys.readouterr()
    bridge = tmp_path / "bridge.yaml"
    bridge.write_text("/**: {ros__parameters: {thrust_map: {battery_voltage: 15.5}}}\n")
    assert main(["identify", str(out), "--config", str(bridge)]) == 0
    printed = capsys.readouterr()
    assert "thrust by (V/15.50 V)^n" in printed.err
    found = yaml.safe_load(printed.out)
    assert found.keys() == {"/**"}
    thrust_map = found["/**"]["ros__parameters"]["thrust_map"]
    assert thrust_map["battery_voltage"] == 15.5
    assert thrust_map["battery_exponent"] == pytest.approx(2.1, abs=0.2)


def test_reports_a_cut_flight_after_a_repair(
    square: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    content = next((square / "bag").glob("*.mcap")).read_bytes()
    cut.write_bytes(content[: int(0.6 * len(content))])
    report = ["report", str(cut), "--out", str(tmp_path / "page.html")]
    assert main(report) == 2
    error = capsys.readouterr().err
    assert error == f"error: {cut}: is unfinished; complete it: quad_mpc bag repair {cut}\n"
    assert main(["bag", "repair", str(cut)]) == 0
    assert main(report) == 0
