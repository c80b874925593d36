"""Parameter files as ROS reads them: in a namespace, dumped and loaded again, with empty lists."""

from __future__ import annotations

import gc
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
import yaml

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode
from quad_mpc_ros.ros.parameter_files import refuse_unread_files
from quad_mpc_ros.ros.spin import run

ROOT = Path(__file__).resolve().parents[2]


def written(path: Path, **sections: object) -> str:
    content = {key: {"ros__parameters": section} for key, section in sections.items()}
    path.write_text(yaml.safe_dump(content))
    return str(path)


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
    assert not ignored_signals() & {signal.SIGINT, signal.SIGTERM}  # or children never hear them
    refuse_unread_files("reference", "/", arguments)


@pytest.mark.parametrize("key", ["/**/mpc", "/uav1/mpc", "/uav1/*"])
def test_accepts_file_that_ros_reads_in_namespace(tmp_path: Path, key: str) -> None:
    path = written(tmp_path / "vehicle.yaml", **{key: {"mass": 0.9}, "mpc": {"mass": 0.8}})
    refuse_unread_files("mpc", "/uav1", ["--ros-args", "--params-file", path])
    other = written(tmp_path / "other.yaml", **{"/**": {"mass": 0.9}, "mpc": {"mass": 0.8}})
    with pytest.raises(UserError, match="ROS does not read it"):
        refuse_unread_files("mpc", "/uav1", ["--ros-args", "--params-file", other])


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("**/*.yaml")), ids=lambda p: p.stem)
def test_shipped_files_are_read_in_every_namespace(path: Path) -> None:
    for name in yaml.safe_load(path.read_text()):
        node = name.removeprefix("/**/")
        refuse_unread_files(node, "/uav1", ["--params-file", str(path)])


@pytest.fixture
def no_node_is_left() -> Iterator[None]:
    """Services of a lifecycle live until their node is collected, and others would ask them."""
    yield
    gc.collect()


@pytest.mark.usefixtures("no_node_is_left")
@pytest.mark.parametrize("namespace", ["/", "/ns_dump"])
def test_loads_given_and_dumped_parameters(tmp_path: Path, namespace: str) -> None:
    given = {
        "mass": 1,
        "advanced": {"realtime": {"cpus": []}},
        "use_sim_time": False,
        "autostart": False,
    }
    path = written(tmp_path / "dumped.yaml", **{"/**/mpc": given})
    rclpy.init(args=["--ros-args", "-r", f"__ns:={namespace}", "--params-file", path])
    try:
        node = MpcNode()
        assert node.get_parameter("mass").value == 1.0
        assert list(node.get_parameter("advanced.realtime.cpus").value) == []
        # As ros2 param dump does it.
        dumped = {name: node.get_parameter(name).value for name in node._parameters}
        node.destroy_node()
    finally:
        rclpy.shutdown()
    plain = {
        name: list(value) if not isinstance(value, str) and hasattr(value, "__len__") else value
        for name, value in dumped.items()
    }
    again = written(tmp_path / "again.yaml", **{"/**/mpc": plain})
    rclpy.init(args=["--ros-args", "-r", f"__ns:={namespace}", "--params-file", again])
    try:
        node = MpcNode()
        assert {name: node.get_parameter(name).value for name in node._parameters} == dumped
        node.destroy_node()
    finally:
        rclpy.shutdown()
