# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The nodes under the real ``ros2``: run, lifecycle, param, service."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from fixtures.installed_ros import Running, ros2, running, wait_for

pytestmark = pytest.mark.timeout(400)  # of a busy machine

MPC, REFERENCE = "/uav1/mpc", "/uav1/reference"
IN_NAMESPACE = ("--ros-args", "-r", "__ns:=/uav1")


def run_node(executable: str, *arguments: str, folder: Path, log: str) -> Iterator[Running]:
    command = ("run", "quad_mpc_ros", executable, *IN_NAMESPACE, *arguments)
    return running(*command, folder=folder, log=log)


def listed(node: str) -> bool:
    # Not by the daemon, which would go on after the tests.
    return node in ros2("node", "list", "--no-daemon", "--spin-time", "1").split()


def asked(group: str, verb: str, *arguments: str, fails: bool = False) -> str:
    """Ask a node, again if it has not been found in half a second."""
    for _ in range(20):
        found = ("--no-daemon", "--spin-time", "0.5")
        answer = ros2(group, verb, *found, *arguments, fails=True)
        if "not found" not in answer.lower():
            break
    assert fails or ("Error" not in answer and "Traceback" not in answer), answer
    return answer


lifecycle = functools.partial(asked, "lifecycle")
param = functools.partial(asked, "param")


def parameters(dump: str) -> dict[str, object]:
    (node,) = yaml.safe_load(dump).values()
    return node["ros__parameters"]


def test_dumped_parameters_load_and_run_again(tmp_path: Path) -> None:
    """``ros2 param dump``, ``load`` into the node that runs, ``--params-file`` for the next."""
    given = ("-p", "autostart:=false", "-p", "odom_timeout:=0.3", "-p", "limits.tilt_max:=0.5")
    dump = tmp_path / "dumped.yaml"
    with run_node("mpc_node", *given, folder=tmp_path, log="first.log") as node:
        wait_for(lambda: listed(MPC), what="listed", while_running=node)
        dump.write_text(param("dump", MPC))
        before = parameters(dump.read_text())
        assert before["odom_timeout"] == 0.3
        assert before["limits"]["tilt_max"] == 0.5
        assert "successful" in param("set", MPC, "odom_timeout", "0.2")
        loaded = param("load", MPC, str(dump))
        failed = [line for line in loaded.splitlines() if "successful" not in line]
        # rclpy's own, which it does not let anybody set.
        assert [line for line in failed if "start_type_description_service" not in line] == []
        assert parameters(param("dump", MPC)) == before
        node.interrupt_all()
        node.ends()
    again = ("--params-file", str(dump))
    with run_node("mpc_node", *again, folder=tmp_path, log="second.log") as node:
        wait_for(lambda: listed(MPC), what="listed", while_running=node)
        assert parameters(param("dump", MPC)) == before


def test_lifecycle_and_services(tmp_path: Path) -> None:
    waits = ("-p", "mode:=on_request")
    with (
        run_node("mpc_node", "-p", "autostart:=false", folder=tmp_path, log="mpc.log") as mpc,
        run_node("reference_node", *waits, folder=tmp_path, log="reference.log") as reference,
    ):
        wait_for(lambda: listed(MPC), what="listed", while_running=mpc)
        assert "successful" in lifecycle("set", MPC, "configure")
        assert "successful" not in lifecycle("set", MPC, "activate", fails=True)
        # There is no odometry.
        wait_for(lambda: "activate refused: " in mpc.text, what="refused", while_running=mpc)
        structural = param("set", MPC, "horizon_steps", "20", fails=True)
        assert "clean up the node first" in structural
        assert "inactive" in lifecycle("get", MPC)
        assert "successful" in lifecycle("set", MPC, "cleanup")

        wait_for(lambda: listed(REFERENCE), what="listed", while_running=reference)
        answer = ros2("service", "call", f"{REFERENCE}/takeoff", "std_srvs/srv/Trigger")
        assert "success=False" in answer
        assert "no usable odometry yet" in answer
        for node in (mpc, reference):
            node.interrupt_all()
            node.ends()
            assert "Traceback" not in node.text
