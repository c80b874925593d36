# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files and overrides of a node: read as ROS reads them, and errors refused."""

from __future__ import annotations

import functools
import gc
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
import yaml
from fixtures.ros_context import initialised
from rclpy.node import Node

from quad_mpc_ros import cli
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.ros.bridges.node import BridgeNode
from quad_mpc_ros.ros.bridges.rates import RatesBridge
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode
from quad_mpc_ros.ros.nodes.visualisation_node import VisualisationNode
from quad_mpc_ros.ros.parameter_files import check_names, read_arguments
from quad_mpc_ros.ros.spin import run
from quad_mpc_ros.ros.stack_node import main as stack_main

ROOT = Path(__file__).resolve().parents[2]


def written(path: Path, **sections: object) -> str:
    content = {key: {"ros__parameters": section} for key, section in sections.items()}
    path.write_text(yaml.safe_dump(content))
    return str(path)


def check(full_name: str, arguments: list[str]) -> None:
    """Check arguments for a node that has the parameters ``a`` and ``mass``."""
    given, _ = read_arguments(arguments)
    check_names(given, {full_name: {"a", "mass"}})


def ignored_signals() -> set[signal.Signals]:
    """Return those of Linux's own list: what rclpy sets, Python does not know."""
    status = Path("/proc/self/status").read_text()
    mask = int(status.split("SigIgn:")[1].split()[0], 16)
    return {number for number in signal.Signals if mask >> (number - 1) & 1}


def test_refuses_file_that_ros_ignores_in_namespace(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    copied = written(tmp_path / "vehicle.yaml", reference={"mass": 0.9})
    arguments = ["--ros-args", "-r", "__ns:=/ns_copy", "--params-file", copied]
    assert run(ReferenceNode, arguments) == 2
    (line,) = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error")]
    assert "'/**/reference:'" in line
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert not ignored_signals() & {signal.SIGINT, signal.SIGTERM}  # or children ignore them
    check("/reference", arguments)


@pytest.mark.parametrize("key", ["/**/mpc", "/uav1/mpc", "/uav1/*"])
def test_accepts_file_that_ros_reads_in_namespace(tmp_path: Path, key: str) -> None:
    path = written(tmp_path / "vehicle.yaml", **{key: {"mass": 0.9}, "mpc": {"mass": 0.8}})
    check("/uav1/mpc", ["--ros-args", "--params-file", path])
    other = written(tmp_path / "other.yaml", **{"/**": {"mass": 0.9}, "mpc": {"mass": 0.8}})
    with pytest.raises(UserError, match="ROS does not read it"):
        check("/uav1/mpc", ["--ros-args", "--params-file", other])


PARAMETER_FILES = sorted(
    path
    for path in (ROOT / "config").glob("**/*.yaml")
    if path.parent.name not in ("campaigns", "gates", "viewers")
)


@pytest.mark.parametrize("path", PARAMETER_FILES, ids=lambda p: p.stem)
def test_shipped_files_are_read_in_every_namespace(path: Path) -> None:
    for section in files.sections("", str(path)):
        assert section.is_read_by(f"/uav1/{section.node.replace('**', 'mpc')}")


KEYS = (
    *("/**", "/*", "/**/*", "/*/*", "mpc", "/mpc", "/**/mpc", "/*/mpc", "/uav1/mpc", "uav1/mpc"),
    *("/uav1/*", "uav1/*", "/uav1/**", "/uav1/**/mpc", "/uav2/mpc", "/uav1/reference", "mpc2"),
)


def test_a_section_is_for_the_nodes_that_ros_reads_it_for(tmp_path: Path) -> None:
    for key in KEYS:
        path = written(tmp_path / "file.yaml", **{key: {"a": 1}})
        (section,) = files.sections("", path)
        for namespace in ("/", "/uav1", "/uav1/deep"):
            arguments = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", path]
            with initialised(arguments):
                node = Node("mpc", automatically_declare_parameters_from_overrides=True)
                read_by_ros = node.has_parameter("a")
                full = node.get_fully_qualified_name()
                node.destroy_node()
            assert section.is_read_by(full) is read_by_ros, f"{key} for {full}"


@pytest.fixture(autouse=True, scope="module")
def no_node_is_left() -> Iterator[None]:
    """Services of a lifecycle live until their node is collected, and others would ask them."""
    yield
    gc.collect()


@pytest.mark.parametrize("namespace", ["/", "/ns_dump"])
def test_loads_given_and_dumped_parameters(tmp_path: Path, namespace: str) -> None:
    given = {
        "mass": 1,
        "obstacles": {"neighbours": []},
        "use_sim_time": False,
        "autostart": False,
    }
    path = written(tmp_path / "dumped.yaml", **{"/**/mpc": given})
    with initialised(["--ros-args", "-r", f"__ns:={namespace}", "--params-file", path]):
        node = MpcNode()
        assert node.get_parameter("mass").value == 1.0
        assert list(node.get_parameter("obstacles.neighbours").value) == []
        # As ros2 param dump does it.
        dumped = {name: node.get_parameter(name).value for name in node._parameters}
        node.destroy_node()
    plain = {
        name: list(value) if not isinstance(value, str) and hasattr(value, "__len__") else value
        for name, value in dumped.items()
    }
    again = written(tmp_path / "again.yaml", **{"/**/mpc": plain})
    with initialised(["--ros-args", "-r", f"__ns:={namespace}", "--params-file", again]):
        node = MpcNode()
        assert {name: node.get_parameter(name).value for name in node._parameters} == dumped
        node.destroy_node()


class _UnspunError(Exception):
    """Instead of spinning."""


@pytest.fixture
def refusal(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a node with arguments for ROS that it refuses; return the line that says why."""

    def refused(create: Callable[[], Node], *arguments: str) -> str:
        assert run(create, ["--ros-args", *arguments]) == 2
        printed = capfd.readouterr().err
        assert "Traceback" not in printed
        lines = [line for line in printed.splitlines() if line.startswith("error")]
        assert len(lines) == 1, lines
        return lines[0].removeprefix("error: ")

    return refused


MISTAKES = {
    "misspelt node": ({"/**/mcp": {"mass": 0.5}}, "given node '/**/mcp', did you mean mpc?"),
    "misspelt node in a namespace": (
        {"uav1/mcp": {"mass": 0.5}},
        "given node 'uav1/mcp', did you",
    ),
    "misspelt other node": ({"referance": {"side": 3.0}}, "did you mean reference?"),
    "misspelt parameter": (
        {"mpc": {"horizn_steps": 5}},
        "horizn_steps: given 5, expected a parameter of /mpc (did you mean horizon_steps?)",
    ),
    "misspelt for all": ({"/**": {"mas": 0.5}}, "mas: given 0.5, expected a parameter of /mpc"),
    "of another node": ({"mpc": {"side": 3.0}}, "side: given 3.0, expected a parameter of /mpc"),
    "out of range": ({"/**": {"mass": -1.0}}, "mpc.mass: given -1.0, expected a number > 0"),
    "mixed list": ({"mpc": {"omega_max": [1e7, 1, 2]}}, "expected elements of one type; write"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_file_is_refused_with_the_name_of_the_file(
    mistake: str, tmp_path: Path, refusal: Callable[..., str]
) -> None:
    sections, reason = MISTAKES[mistake]
    file = written(tmp_path / "vehicle.yaml", **sections)
    line = refusal(MpcNode, "--params-file", file)
    assert line.startswith(f"{file}: ")
    assert reason in line


REFUSED_BY_ROS = {
    "mixed list": "mpc: {ros__parameters: {fence: {minimum: [-5, -5.0, 0]}}}",
    "alias": "mpc: {ros__parameters: {mass: &m 1.0, gravity: *m}}",
    "empty group": "mpc: {ros__parameters: {limits: {}, mass: 1.0}}",
    "empty name": "mpc: {ros__parameters: {'': 1.0}}",
    "no value": "mpc: {ros__parameters: {mass: }}",
    "no node": "ros__parameters: {mass: 1.0}",
}


@pytest.mark.parametrize("kind", REFUSED_BY_ROS)
def test_a_file_that_ros_cannot_read_is_refused_by_every_program_in_the_same_words(
    kind: str,
    tmp_path: Path,
    refusal: Callable[..., str],
    capfd: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(REFUSED_BY_ROS[kind])
    with pytest.raises(RuntimeError):
        rclpy.init(args=["--ros-args", "--params-file", str(file)])
    line = refusal(MpcNode, "--params-file", str(file))
    assert line.startswith(f"{file}: ")
    assert cli.main(["simulate", "--config", str(file), "--out", str(tmp_path / "run")]) == 2
    assert capfd.readouterr().err == f"error: {line}\n"


OVERRIDES = {
    "misspelt:=1": "-p: misspelt: given 1, expected a parameter of /mpc",
    "horizn_steps:=5": "did you mean horizon_steps?",
    "Q:=[1,2": "-p Q: given '[1,2', expected a YAML value",
    "Q:={a: 1}": "-p Q: given '{a: 1}', expected one value or a list",
    "Q:=[1, 2]": "mpc.Q: given [1, 2], expected 9 numbers >= 0",
    "mass": "-p: given 'mass', expected name:=value",
    "mass=1": "-p: given 'mass=1', expected name:=value",
    "mass:=": "ROS rejects the arguments",
    "mcp:mass:=1": "given node 'mcp', did you mean mpc?",
}


@pytest.mark.parametrize("override", OVERRIDES)
def test_a_mistake_in_an_override_is_refused(override: str, refusal: Callable[..., str]) -> None:
    assert OVERRIDES[override] in refusal(MpcNode, "-p", override)


def test_an_override_for_a_node_of_another_process_is_refused(
    capfd: pytest.CaptureFixture[str],
) -> None:
    arguments = ["--ros-args", "-p", "mpc:mass:=1", "-r", "__ns:=/uav1"]
    assert run(VisualisationNode, arguments) == 2
    line = capfd.readouterr().err.splitlines()[-1]
    assert line == (
        "error: -p mpc:mass: ROS reads it for /mpc, expected /uav1/visualisation; "
        "write -p mass:=VALUE"
    )


UNREADABLE = {
    "tabs": (b"mpc:\n\tros__parameters: {mass: 1.0}\n", "indent with spaces, not with tabs"),
    "not UTF-8": ("mpc: {ros__parameters: {mass: 1.0}} # \xe9".encode("latin-1"), "not UTF-8"),
    "no parameters": (b"mpc: {mass: 1.0}\n", "mpc/mass: expected 'ros__parameters:' below it"),
    "a list": (b"- mpc\n", "expected 'node: ros__parameters: "),
    "given twice": (b"mpc: {ros__parameters: {mass: 1.0, mass: 2.0}}\n", "'mass' is given twice"),
}


@pytest.mark.parametrize("kind", UNREADABLE)
def test_a_file_that_cannot_be_read_is_refused(
    kind: str, tmp_path: Path, refusal: Callable[..., str]
) -> None:
    content, reason = UNREADABLE[kind]
    file = tmp_path / "vehicle.yaml"
    file.write_bytes(content)
    line = refusal(VisualisationNode, "--params-file", str(file))
    assert str(file) in line
    assert reason in line


def test_a_file_that_is_not_there_is_refused_by_every_node(
    tmp_path: Path, refusal: Callable[..., str], capfd: pytest.CaptureFixture[str]
) -> None:
    wrong = ("--params-file", str(tmp_path / "vehicle.yaml"))
    expected = f"given '{tmp_path / 'vehicle.yaml'}', which does not exist"
    for create in (MpcNode, ReferenceNode, functools.partial(BridgeNode, RatesBridge)):
        assert expected in refusal(create, *wrong)
    assert stack_main(["stack_node", "--ros-args", *wrong]) == 2
    assert expected in capfd.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["vehicle.yaml"], ["--ros-args", "--", "-p", "mass:=1"]],
)
def test_refuses_arguments_that_are_not_for_ros(
    arguments: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(VisualisationNode, arguments) == 2
    assert "expected arguments for ROS, after --ros-args" in capfd.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["-r", "__ns:=/a-b"], ["-r", "x"], ["--log-level", "loud"], ["--nonsense"], ["-p"]],
)
def test_reports_a_refusal_by_ros_in_one_line(
    arguments: list[str], refusal: Callable[..., str]
) -> None:
    assert refusal(VisualisationNode, *arguments).startswith("ROS rejects the arguments: ")


FOREIGN: dict[str, dict[str, object]] = {
    "sections of other nodes": {
        "planner": {"mass": "unknown", "horizn_steps": 3},
        "/uav2/mpc2": {"anything": 1},
        "controller_server": {"FollowPath.max_speed": 0.5},
        "map_server": {"yaml_filename": "a.yaml"},
    },
    "of all nodes": {"/**": {"robot_radius": 0.3, "model": "iris", "weight": 2.0, "size": 3}},
    "near a name that is there": {"mpc": {"mass": 0.5}, "mpcc": {"mass": 0.5, "lag_weight": 1.0}},
    "near a parameter that is there": {"/**": {"mass": 0.5, "masss": 0.5}},
    "other nodes of ours": {"reference": {"height": 3.0}, "/**": {"trajectory": "circle"}},
    "parameters of ROS": {"/**": {"use_sim_time": False}, "mpc": {"use_sim_time": False}},
}


@pytest.mark.parametrize("shared", FOREIGN)
def test_ignores_parameters_of_nodes_of_other_packages(shared: str, tmp_path: Path) -> None:
    path = written(tmp_path / "stack.yaml", **FOREIGN[shared])
    arguments = ["--ros-args", "--params-file", path, "-p", "autostart:=false"]
    with initialised(arguments):
        node = MpcNode()
        known = node.get_parameters_by_prefix("")
        check_names(read_arguments(arguments)[0], {node.get_fully_qualified_name(): known})
        assert node.get_parameter("horizon_steps").value == 12
        node.destroy_node()


def test_vehicle_file_applies_to_every_node(tmp_path: Path) -> None:
    vehicle = {"mass": 0.5, "omega_max": [8.0, 8.0, 4.0], "throttle_max": 0.9, "drag": 0.3}
    path = written(
        tmp_path / "vehicle.yaml", **{"/**": {**vehicle, "thrust_map": {"kind": "model"}}}
    )
    arguments = ["--ros-args", "--params-file", path]
    with initialised(arguments):
        reference = ReferenceNode()
        bridge = BridgeNode(RatesBridge)
        assert reference.get_parameter("mass").value == 0.5
        assert reference.get_parameter("throttle_max").value == 0.9
        assert not reference.has_parameter("input_delay")
        assert bridge.get_parameter("mass").value == 0.5
        bridge.destroy_node()
        reference.destroy_node()


def test_an_override_in_one_process_applies_to_its_node(
    capfd: pytest.CaptureFixture[str],
) -> None:
    modes: list[str] = []

    def reference() -> Node:
        node = ReferenceNode()
        modes.append(node.get_parameter("mode").value)
        raise _UnspunError

    arguments = ["--ros-args", "-r", "__ns:=/uav1", "-p", "mode:=on_request"]
    arguments += ["-p", "use_sim_time:=false", "-p", "mass:=0.5"]
    with pytest.raises(_UnspunError):
        run(VisualisationNode, arguments, others=[reference])
    assert modes == ["on_request"]
    wrong = [*arguments, "-p", "colour:=red"]
    assert run(VisualisationNode, wrong, others=[ReferenceNode]) == 2
    line = capfd.readouterr().err.splitlines()[-1]
    assert line == (
        "error: -p: colour: given 'red', expected a parameter of /uav1/visualisation or "
        "/uav1/reference"
    )
