# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The shipped SROS 2 policies allow what the nodes open, and little else."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

POLICIES = Path(__file__).resolve().parents[3] / "config" / "security" / "policies.xml"
# Not the root, where a node that another test has left would be taken for one of these.
SPACE = "/policed"
NODES = ("simulator", "reference", "mpc", "recorder", "visualisation")
# Only opened in some cases: on simulated time or in lockstep, with tf2_msgs, once a publisher
# exists, or with a plant that has it.
SOMETIMES = {"/battery", "/clock", "/imu", "/tf", "/engaged", "/landed", "/odom_reset"}
OPENED = {
    ("topics", "publish"): "get_publisher_names_and_types_by_node",
    ("topics", "subscribe"): "get_subscriber_names_and_types_by_node",
    ("services", "reply"): "get_service_names_and_types_by_node",
    ("services", "request"): "get_client_names_and_types_by_node",
}


def allowed(node: str, kind: str, how: str) -> set[str]:
    """Return the full names of what the profile of a node in the root namespace allows."""
    (profile,) = ElementTree.parse(POLICIES).getroot().iterfind(f".//profile[@node='{node}']")
    assert profile.get("ns") == "/"
    names = [
        str(element.text)
        for group in profile.findall(f"{kind}[@{how}='ALLOW']")
        for element in group
    ]
    return {name if name.startswith("/") else f"/{name}" for name in names}


def test_every_enclave_has_one_profile_of_its_name() -> None:
    enclaves = ElementTree.parse(POLICIES).getroot().findall("enclaves/enclave")
    found = {enclave.get("path"): enclave.findall("profiles/profile") for enclave in enclaves}
    assert {path: [profile.get("node") for profile in found[path]] for path in found} == {
        f"/quad_mpc/{node}": [node] for node in NODES
    }


def test_nodes_use_exactly_what_policies_allow(
    start: Callable[..., Any], peer: Any, tmp_path: Path
) -> None:
    for node in NODES:
        more = ("-p", f"directory:={tmp_path / 'bag'}") if node == "recorder" else ()
        start(node, "-r", f"__ns:={SPACE}", *more)

    def excess() -> list[str]:
        """Endpoints that are opened and not allowed, or allowed and not opened."""
        found = []
        for node in NODES:
            for (kind, how), query in OPENED.items():
                try:
                    names = [name for name, _ in getattr(peer.node, query)(node, SPACE)]
                except Exception:  # of another class in each version
                    return [f"{node} is not there yet"]
                opened = {name.removeprefix(SPACE) for name in names}
                may = allowed(node, kind, how)
                found += [f"{node} {how} {name}: not allowed" for name in opened - may]
                found += [f"{node} {how} {name}: not needed" for name in may - opened - SOMETIMES]
        return found

    peer.wait(lambda: not excess())
    assert excess() == []


def test_the_tools_of_sros_2_load_them() -> None:
    policy = pytest.importorskip("sros2.policy", reason="ros-jazzy-sros2 is not installed")
    policy.load_policy(str(POLICIES))
