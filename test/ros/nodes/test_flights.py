# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whole flights over DDS with the four nodes as processes."""

from __future__ import annotations

import importlib.metadata
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from fixtures.bag_payloads import payloads
from fixtures.courses import COURSE
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from quad_mpc_ros.cli import main

CONTROL_TOPICS = ("/odom", "/reference", "/command", "/mpc/stats", "/mpc/predicted_path")


def _fly(out: Path, *arguments: str) -> Path:
    assert main(["fly", "--lockstep", "--config", "paper", *arguments, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def lockstep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _fly(tmp_path_factory.mktemp("lockstep") / "run")


@pytest.fixture(scope="module")
def real_time(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # Ten odometries a second, and timeouts longer than other work can starve a node: then a
    # failsafe would be a fault.
    out = tmp_path_factory.mktemp("real_time") / "run"
    rates = ("simulator.odom_rate=10", "mpc.control_rate=10", "mpc.advanced.deadline=1")
    timeouts = ("mpc.odom_timeout=2", "mpc.reference_timeout=2")
    given = [f"--set={assignment}" for assignment in (*rates, *timeouts)]
    assert main(["fly", "--duration", "8", *given, "--out", str(out)]) == 0
    return out


def test_simulate_and_lockstep_flight_send_identical_commands(
    lockstep: Path, tmp_path: Path
) -> None:
    out = tmp_path / "simulated"
    assert main(["simulate", "--config", "paper", "--out", str(out)]) == 0
    assert payloads(out / "bag") == payloads(lockstep / "bag")


BROKEN = """
import dataclasses
import time
from quad_mpc_ros.extras.controllers.geometric import GeometricController

class Broken(GeometricController):
    left = 60

    def step(self, odometry, reference):
        self.left -= 1
        command = super().step(odometry, reference)
        return command if self.left >= 0 else self.broken(command)

class Raises(Broken):
    def broken(self, command):
        raise RuntimeError("no ideas left")

class Type(Broken):
    def broken(self, command):
        return command.throttle, command.w_WB_B

class Shape(Broken):
    def broken(self, command):
        return dataclasses.replace(command, w_WB_B=command.w_WB_B[:2])

class NotANumber(Broken):
    def broken(self, command):
        return dataclasses.replace(command, throttle=float("nan"))

class Late(Broken):
    def broken(self, command):
        until = time.thread_time() + 0.03
        while time.thread_time() < until:
            pass
        return command

class Rotors(GeometricController):
    commands_rotors = True
"""
OUT = "; it stays out until it is engaged again"


@pytest.mark.parametrize(
    ("kind", "logged"),
    [
        ("Raises", f"RuntimeError: no ideas left{OUT}"),
        ("Type", f"expected CommandSample{OUT}"),
        ("Shape", f"w_WB_B: given an array (2,) of float64, expected 3 numbers{OUT}"),
        ("NotANumber", f"throttle: given nan, expected a finite number{OUT}"),
        ("Late", "plan takes over: late: the controller took"),
    ],
)
def test_a_controller_flies_in_the_node_until_it_fails(
    kind: str, logged: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_controller.py").write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    name = f"broken_controller:{kind}"
    options = ["--lockstep", "--controller", name, "--reference", "hover"]
    assert main(["fly", *options, "--duration", "2", "--out", "run"]) == 1
    commanding = json.loads(Path("run/summary.json").read_text())["commanding"]
    assert commanding["ticks"]["mpc"] == 60 and commanding["ticks"]["hover"] > 20
    log = Path("run/log/mpc.log").read_text()
    assert f"{name} flies" in log
    assert log.count(logged) == 1


def test_the_node_refuses_a_controller_of_rotors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken_controller.py").write_text(BROKEN)
    monkeypatch.chdir(tmp_path)
    options = ["--lockstep", "--controller", "broken_controller:Rotors", "--reference", "hover"]
    assert main(["fly", *options, "--duration", "2", "--out", "run"]) != 0
    expected = "expected a controller of throttle and body rates"
    assert expected in capsys.readouterr().err + Path("run/log/mpc.log").read_text()


def test_a_planned_race_is_the_same_in_lockstep_and_simulated(tmp_path: Path) -> None:
    pytest.importorskip("casadi")
    course, plan = tmp_path / "course.yaml", tmp_path / "race.csv"
    course.write_text(yaml.safe_dump(COURSE))
    vehicle = ["--config", "vehicles/cpc"]
    assert main(["plan", str(course), *vehicle, "--step", "0.08", "--out", str(plan)]) == 0
    given = [*vehicle, "--gates", str(course), "--set", f"reference.file={plan}"]
    given += ["--set", "mpc.formulation=contouring", "--duration", "3.5"]
    flown, simulated = tmp_path / "flown", tmp_path / "simulated"
    assert main(["fly", "--lockstep", *given, "--out", str(flown)]) == 0
    assert main(["simulate", *given, "--out", str(simulated)]) == 0
    assert len(payloads(flown / "bag")) > 100
    assert payloads(flown / "bag") == payloads(simulated / "bag")
    summaries = [json.loads((run / "summary.json").read_text()) for run in (flown, simulated)]
    assert [gate["passed"] for gate in summaries[0]["gates"]] == [True, True]
    for entry in ("gates", "lap_time_s", "progress_delay_max_s", "position_rmse_m"):
        assert summaries[0][entry] == summaries[1][entry]


def test_a_lockstep_flight_resolves_to_the_same_commands(lockstep: Path, tmp_path: Path) -> None:
    assert main(["resolve", str(lockstep), "--out", str(tmp_path / "again")]) == 0
    assert payloads(tmp_path / "again" / "bag") == payloads(lockstep / "bag")


def test_a_real_time_flight_resolves_nearly_to_the_same_commands(
    real_time: Path, tmp_path: Path
) -> None:
    """Nearly: the recording does not always have the order of two references."""
    assert main(["resolve", str(real_time), "--out", str(tmp_path / "again")]) == 0
    summary = json.loads((tmp_path / "again" / "summary.json").read_text())
    # After the last odometry, until the nodes have ended, what is commanded answers none.
    flown = json.loads((real_time / "summary.json").read_text())
    assert summary["compared"] >= 0.95 * (flown["odometries"] - flown["unanswered_odometries"])
    assert summary["only_resolved"] <= 0.05 * summary["compared"]
    for channel in summary["difference"].values():
        assert channel["p50"] <= 1e-6


def test_lockstep_flight_is_the_papers_square(lockstep: Path) -> None:
    summary = json.loads((lockstep / "summary.json").read_text())
    assert summary["position_rmse_m"] == pytest.approx(0.788, abs=0.01)
    assert max(summary["waypoint_error_m"]) <= 0.03
    assert summary["iterations"]["max"] <= 100
    assert summary["solver_failures"] == 0


def test_bag_contains_every_message_of_the_flight(lockstep: Path) -> None:
    with AnyReader([lockstep / "bag"]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert {counts[topic] for topic in CONTROL_TOPICS} == {500}
    assert counts["/clock"] == 500
    assert counts["/reference/path"] == 1


def test_bag_decodes_with_another_reader(lockstep: Path) -> None:
    (mcap,) = (lockstep / "bag").glob("*.mcap")
    with mcap.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        height = [
            message.pose.pose.position.z
            for _, _, _, message in reader.iter_decoded_messages(topics=["/odom"])
        ]
    assert len(height) == 500
    assert height[0] == 0.0
    assert height[-1] == pytest.approx(2.0, abs=0.03)


def test_bag_contains_the_type_hashes_of_the_message_packages(lockstep: Path) -> None:
    metadata = yaml.safe_load((lockstep / "bag" / "metadata.yaml").read_text())
    for entry in metadata["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        assert topic["type_description_hash"] == _installed_hash(topic["type"]), topic["name"]


def test_bag_contains_the_parameters_of_every_node(lockstep: Path) -> None:
    (mcap,) = (lockstep / "bag").glob("*.mcap")
    with mcap.open("rb") as stream:
        records = {r.name: r.metadata for r in make_reader(stream).iter_metadata()}
    mpc = yaml.safe_load(records["parameters:mpc"]["yaml"])["mpc"]["ros__parameters"]
    simulator = yaml.safe_load(records["parameters:simulator"]["yaml"])["simulator"]
    assert mpc["Q"] == [10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.01]
    assert mpc["use_sim_time"] is True
    assert simulator["ros__parameters"]["dynamics"] == "paper"
    assert {"parameters:reference", "parameters:recorder"} <= set(records)


def test_real_time_flight_answers_the_odometry(real_time: Path) -> None:
    """A machine that stalls may lose a tick or two; a wiring fault loses them all."""
    summary = json.loads((real_time / "summary.json").read_text())
    assert summary["odometries"] == 80
    assert summary["unanswered_odometries"] <= 2
    assert summary["fallbacks"] == 0
    assert max(summary["waypoint_error_m"]) <= 0.1


def test_real_time_commands_answer_the_stamps_of_the_odometry(real_time: Path) -> None:
    with AnyReader([real_time / "bag"]) as reader:
        stamps: dict[str, list[int]] = {"/odom": [], "/command": []}
        for connection, _, data in reader.messages(
            [c for c in reader.connections if c.topic in stamps]
        ):
            stamp = reader.deserialize(data, connection.msgtype).header.stamp
            stamps[connection.topic].append(stamp.sec * 10**9 + stamp.nanosec)
    last = stamps["/odom"][-1]
    answers = [stamp for stamp in stamps["/command"] if stamp <= last]
    assert set(answers) <= set(stamps["/odom"])
    assert len(set(answers)) == len(answers)
    assert np.all(np.diff(stamps["/odom"]) > 0)


def test_flight_without_ros_names_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def find_spec(name: str) -> None:
        return None

    monkeypatch.setattr("importlib.util.find_spec", find_spec)
    assert main(["fly", "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert "quad_mpc simulate" in error
    assert len(error.strip().splitlines()) == 1


def _installed_hash(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    files = importlib.metadata.files(f"ros-{package.replace('_', '-')}")
    if files is not None:
        (path,) = (f for f in files if str(f).endswith(f"share/{package}/{kind}/{name}.json"))
        description = json.loads(Path(str(path.locate())).read_text())
    else:
        share = Path(sys.prefix) / "share" / package / kind / f"{name}.json"
        description = json.loads(share.read_text())
    return next(
        h["hash_string"] for h in description["type_hashes"] if h["type_name"] == type_name
    )
