# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Execute the launch files with a fake launch API, because no wheel contains the real one.

The stand-in takes what launch and launch_ros of Jazzy take, as far as the files use it, and
refuses everything else. It resolves substitutions and conditions in order, as ``ros2 launch``
does, and starts nothing.
"""

from __future__ import annotations

import functools
import gc
import runpy
import sys
import time
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import rclpy.node
import yaml
from fixtures.setup_py import declared, write_metadata

from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import Configuration, UserError, files
from quad_mpc_ros.messages.markers import VisualisationConfig
from quad_mpc_ros.messages.topics import REP147_NAMES
from quad_mpc_ros.ros.bridges.registry import bridge_configurations
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode

ROOT = Path(__file__).parents[2]
LAUNCH_FILES = sorted(path.name for path in (ROOT / "launch").glob("*.launch.py"))
TRUE, FALSE = ("true", "1"), ("false", "0")


class LaunchError(Exception):
    """The error with which ``ros2 launch`` would end."""


@dataclass
class Context:
    """Arguments given on the command line, and what has been declared so far."""

    given: dict[str, str]
    values: dict[str, str] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)

    def text(self, value: Any) -> str:
        """Resolve a substitution, a text, or a list of them, which is joined."""
        match value:
            case str():
                return value
            case LaunchConfiguration():
                if value.name not in self.values:
                    raise LaunchError(f"launch configuration '{value.name}' does not exist")
                self.used.add(value.name)
                return self.values[value.name]
            case EqualsSubstitution():
                return str(self.text(value.left) == self.text(value.right)).lower()
            case NotEqualsSubstitution():
                return str(self.text(value.left) != self.text(value.right)).lower()
            case list() | tuple():
                return "".join(map(self.text, value))
        raise LaunchError(f"neither a text nor a substitution: {value!r}")


@dataclass
class LaunchConfiguration:
    name: str

    def perform(self, context: Context) -> str:
        return context.text(self)


@dataclass
class EqualsSubstitution:
    left: Any
    right: Any


@dataclass
class NotEqualsSubstitution:
    left: Any
    right: Any


@dataclass
class IfCondition:
    predicate: Any

    def holds(self, context: Context) -> bool:
        text = context.text(self.predicate).lower()
        if text not in (*TRUE, *FALSE):
            raise LaunchError(f"not a condition: {text!r}")
        return text in TRUE


class DeclareLaunchArgument:
    def __init__(
        self,
        name: str,
        *,
        default_value: Any = None,
        description: str | None = None,
        choices: list[str] | None = None,
        condition: IfCondition | None = None,
    ) -> None:
        assert description, f"argument {name} is not described"
        if choices is not None and default_value is not None:
            assert default_value in choices
        self.name, self.default, self.choices = name, default_value, choices

    def execute(self, context: Context) -> None:
        if self.name in context.values:  # of the file that includes this one
            value = context.values[self.name]
        elif self.name in context.given:
            value = context.given[self.name]
        elif self.default is None:
            raise LaunchError(f"required launch argument '{self.name}' was not provided")
        else:
            value = context.text(self.default)
        if self.choices is not None and value not in self.choices:
            raise LaunchError(f"argument '{self.name}' is not one of {self.choices}: {value}")
        context.values[self.name] = value


@dataclass
class ParameterValue:
    value: Any
    value_type: type | None = None

    def resolved(self, context: Context) -> Any:
        value = yaml.safe_load(context.text(self.value))
        if self.value_type is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if self.value_type is not None and type(value) is not self.value_type:
            raise LaunchError(f"{value!r} is not of type {self.value_type.__name__}")
        return value


@dataclass(kw_only=True)
class Node:
    """Takes what launch_ros takes, as far as these files give it."""

    executable: Any
    package: Any
    namespace: Any
    parameters: list[Any]
    output: str
    name: Any = ""
    arguments: list[Any] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)
    remappings: list[tuple[Any, Any]] = field(default_factory=list)
    condition: IfCondition | None = None


@dataclass(kw_only=True)
class Shutdown:
    reason: str = "reason not given"


@dataclass(kw_only=True)
class EmitEvent:
    event: Shutdown


@dataclass(kw_only=True)
class OnProcessExit:
    target_action: Node
    on_exit: list[EmitEvent]


@dataclass(kw_only=True)
class OpaqueFunction:
    function: Callable[[Context], list[Any]]


@dataclass
class IncludeLaunchDescription:
    launch_description_source: str
    launch_arguments: list[tuple[str, Any]] = field(default_factory=list)


@dataclass
class RegisterEventHandler:
    event_handler: OnProcessExit


@dataclass
class LaunchDescription:
    entities: list[Any]


MODULES = {
    "launch": [LaunchDescription],
    "launch.actions": [
        DeclareLaunchArgument,
        EmitEvent,
        IncludeLaunchDescription,
        OpaqueFunction,
        RegisterEventHandler,
    ],
    "launch.conditions": [IfCondition],
    "launch.event_handlers": [OnProcessExit],
    "launch.events": [Shutdown],
    "launch.substitutions": [EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.parameter_descriptions": [ParameterValue],
}


@dataclass(frozen=True, kw_only=True)
class Started:
    """A node as it would be started; ``parameters`` are files and values, later ones win.

    ``words`` are its arguments, those for ROS last.
    """

    package: str
    executable: str
    name: str
    namespace: str
    parameters: tuple[Path | dict[str, Any], ...]
    remappings: dict[str, str]
    words: tuple[str, ...]


def started(node: Node, context: Context) -> Started:
    assert node.output == "screen"
    return Started(
        package=context.text(node.package),
        executable=context.text(node.executable),
        name=context.text(node.name),
        namespace=context.text(node.namespace),
        parameters=tuple(
            {name: value.resolved(context) for name, value in each.items()}
            if isinstance(each, dict)
            else Path(context.text(each))
            for each in node.parameters
        ),
        remappings={context.text(a): context.text(b) for a, b in node.remappings},
        words=tuple(map(context.text, [*node.arguments, *node.ros_arguments])),
    )


Launch = Callable[..., list[Started]]


@pytest.fixture
def launch(monkeypatch: pytest.MonkeyPatch) -> Launch:
    """Execute a launch file with arguments; every argument that it declares must be of use."""
    for name, members in MODULES.items():
        module = types.ModuleType(name)
        for member in members:
            setattr(module, member.__name__, member)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(
        "ament_index_python.packages.get_package_share_directory",
        lambda package: {"quad_mpc_ros": str(ROOT)}[package],
    )

    def execute(file: str, **arguments: str) -> list[Started]:
        def entities_of(path: str) -> list[Any]:
            described = runpy.run_path(path)["generate_launch_description"]()
            return list(described.entities)

        context = Context(given=arguments)
        nodes: dict[int, Started] = {}
        entities = entities_of(str(ROOT / "launch" / file))
        while entities:
            entity = entities.pop(0)
            match entity:
                case OpaqueFunction():
                    entities = [*entity.function(context), *entities]
                case IncludeLaunchDescription():
                    included = entities_of(entity.launch_description_source)
                    passed = {name: context.text(v) for name, v in entity.launch_arguments}
                    for declared_argument in included:
                        # As launch has it, which looks at nothing else that is given.
                        match declared_argument:
                            case DeclareLaunchArgument(name=name, default=None):
                                assert name in passed, f"required argument {name} is not passed"
                    context.values.update(passed)
                    entities = [*included, *entities]
                case DeclareLaunchArgument():
                    entity.execute(context)
                case Node():
                    runs = entity.condition is None or entity.condition.holds(context)
                    resolved = started(entity, context)
                    if runs:
                        nodes[id(entity)] = resolved
                case RegisterEventHandler():
                    assert id(entity.event_handler.target_action) in nodes
                case _:
                    raise LaunchError(f"no action: {entity!r}")
        assert arguments.keys() <= context.values.keys(), "an undeclared argument"
        assert context.used == context.values.keys(), "an unused argument"
        return list(nodes.values())

    return execute


CONFIGS = {**SCHEMA, "visualisation": VisualisationConfig, **bridge_configurations()}
BRIDGES = [name.removesuffix("_bridge") for name in declared("quad_mpc_ros.bridges")]


@functools.cache
def loaded(path: Path) -> dict[str, Configuration]:
    """Return what a parameter file makes of every node."""
    return files.load([str(path)], [], schema=CONFIGS)


CALLS: list[tuple[str, dict[str, str]]] = [
    ("square.launch.py", {}),
    ("square.launch.py", {"record": "false", "lockstep": "true", "duration": "10.0"}),
    ("square.launch.py", {"visualise": "true", "namespace": "uav1", "duration": "10"}),
    ("fleet.launch.py", {}),
    ("fleet.launch.py", {"vehicles": "3", "record": "true", "duration": "10"}),
    ("mpc.launch.py", {}),
    ("mpc.launch.py", {"with_reference": "false", "odom": "/uav1/odometry/filtered"}),
    *(("bridge.launch.py", {"bridge": bridge}) for bridge in BRIDGES),
    *(("bridge.launch.py", {"bridge": bridge, "one_process": "false"}) for bridge in BRIDGES),
    ("bridge.launch.py", {"bridge": "px4", "with_reference": "false", "namespace": "uav1"}),
    ("bridge.launch.py", {"bridge": "px4", "rep147": "true"}),
    ("fleet.launch.py", {"one_process": "false"}),
    ("stack.launch.py", {}),
    *(("stack.launch.py", {"bridge": bridge, "namespace": "uav1"}) for bridge in BRIDGES),
]
IDS = ["-".join((file.partition(".")[0], *given.values())) for file, given in CALLS]


def test_every_launch_file_is_called() -> None:
    assert {file for file, _ in CALLS} == set(LAUNCH_FILES)


@pytest.mark.parametrize(("file", "given"), CALLS, ids=IDS)
def test_every_node_exists_and_takes_its_parameters(
    file: str, given: dict[str, str], launch: Launch
) -> None:
    nodes = launch(file, **given)
    assert nodes
    for node in nodes:
        assert node.package == "quad_mpc_ros"
        assert node.executable in declared("console_scripts")
        if node.executable == "stack_node":  # several, which keep their names
            assert node.name == ""
            if file != "fleet.launch.py":
                bridge, reference = (
                    given.get("bridge", "none"),
                    given.get("with_reference", "true"),
                )
                assert node.words[:4] == ("--bridge", bridge, "--reference", reference)
                mode = ("-p", "mode:=on_request") if reference == "true" else ()
                assert node.words[4:] == mode
            continue
        # Parameter files select nodes by name, so names must be distinct.
        assert node.executable in (f"{node.name}_node", node.name)
        if file != "fleet.launch.py":
            assert node.namespace == given.get("namespace", "")
        config = CONFIGS[node.name]()
        for source in node.parameters:
            if isinstance(source, Path):
                config = loaded(source)[node.name]
            else:
                values = {name: value for name, value in source.items() if name != "use_sim_time"}
                config = config.updated(values)


@pytest.mark.parametrize("node", CONFIGS)
def test_the_parameter_file_of_every_node_is_accepted_by_it(node: str) -> None:
    path = ROOT / "config" / f"{node}.yaml"
    assert files.load([str(path)], [], schema={node: CONFIGS[node]})[node] == CONFIGS[node]()


@pytest.mark.parametrize("bridge", BRIDGES)
def test_one_vehicle_file_applies_to_every_node_and_a_bridge(
    bridge: str, launch: Launch, tmp_path: Path
) -> None:
    vehicle = tmp_path / "my_vehicle.yaml"
    vehicle.write_text("/**:\n  ros__parameters: {mass: 0.5, thrust_curve: [2.0, 3.0, 0.0]}\n")
    names = set()
    (stack,) = launch("bridge.launch.py", bridge=bridge, config=str(vehicle))
    assert stack.parameters == (vehicle,)
    apart = {"bridge": bridge, "config": str(vehicle), "one_process": "false"}
    for node in launch("bridge.launch.py", **apart):
        waits = ({"mode": "on_request"},) if node.name == "reference" else ()
        assert node.parameters == (vehicle, *waits)
        config = files.load([str(vehicle)], [], schema={node.name: CONFIGS[node.name]})[node.name]
        assert config.flattened()["mass"] == 0.5
        names.add(node.name)
    assert names == {f"{bridge}_bridge", "mpc", "reference"}


def test_rosflight_launch_remaps_the_mpcs_command_topic(launch: Launch) -> None:
    for bridge in ("rosflight", "px4"):
        apart = launch("bridge.launch.py", bridge=bridge, one_process="false")
        (mpc,) = (node for node in apart if node.name == "mpc")
        topic = CONFIGS[f"{bridge}_bridge"]().flattened()["advanced.mpc_command_topic"]
        assert mpc.remappings.get("command", "command") == topic
        for file in ("bridge.launch.py", "stack.launch.py"):
            (stack,) = launch(file, bridge=bridge)
            assert stack.remappings.get("mpc:command", "command") == topic


def test_rep147_remaps_the_requests_of_the_reference(launch: Launch) -> None:
    for one_process, prefix in (("true", "reference:"), ("false", "")):
        nodes = launch("bridge.launch.py", bridge="px4", rep147="true", one_process=one_process)
        remappings = [node.remappings for node in nodes if node.name in ("", "reference")]
        assert remappings == [{f"{prefix}{name}": to for name, to in REP147_NAMES.items()}]


def test_fleet_nodes_have_one_namespace_per_vehicle(launch: Launch) -> None:
    executables = {
        "true": ("recorder_node", "simulator_node", "stack_node"),
        "false": ("mpc_node", "recorder_node", "reference_node", "simulator_node"),
    }
    for one_process, expected in executables.items():
        nodes = launch("fleet.launch.py", vehicles="3", record="true", one_process=one_process)
        assert sorted((node.namespace, node.executable) for node in nodes) == [
            (f"uav{number}", executable) for number in (1, 2, 3) for executable in expected
        ]
    for wrong in ("0", "-1", "two", ""):
        with pytest.raises(UserError, match=f"vehicles: given '{wrong}', expected a whole number"):
            launch("fleet.launch.py", vehicles=wrong)


def test_rejects_wrong_launch_arguments(launch: Launch) -> None:
    with pytest.raises(LaunchError, match="'bridge' was not provided"):
        launch("bridge.launch.py")
    with pytest.raises(LaunchError, match="not one of"):
        launch("bridge.launch.py", bridge="kite")
    with pytest.raises(LaunchError, match="not of type float"):
        launch("square.launch.py", duration="long")


FILE_TAKERS = [
    (file, {"bridge": "px4"} if file == "bridge.launch.py" else {}) for file in LAUNCH_FILES
]


@pytest.mark.parametrize(("file", "given"), FILE_TAKERS, ids=LAUNCH_FILES)
def test_missing_parameter_file_is_rejected_with_the_nearest_name(
    file: str, given: dict[str, str], launch: Launch, tmp_path: Path
) -> None:
    there = tmp_path / "my_vehicle.yaml"
    there.write_text("/**: {ros__parameters: {mass: 0.5}}\n")
    wrong = str(tmp_path / "my_vehcle.yaml")
    refused = f"config: given '{wrong}', which does not exist, expected .*did you mean {there}"
    with pytest.raises(UserError, match=refused):
        launch(file, config=wrong, **given)
    with pytest.raises(UserError, match="which is a folder"):
        launch(file, config=str(tmp_path), **given)
    with pytest.raises(UserError, match=r"did you mean .*/config/agile\.yaml"):
        launch(file, config="agile", **given)
    there.write_text("/**/mcp: {ros__parameters: {mass: 0.5}}\n")
    with pytest.raises(UserError, match=r"given node '/\*\*/mcp', did you mean mpc"):
        launch(file, config=str(there), **given)


def test_bridges_of_other_packages_are_launched_from_there(
    launch: Launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry_points = {"quad_mpc_ros.bridges": ["kite_bridge = a_kite:KiteBridge"]}
    write_metadata(tmp_path, "kite_pilot", entry_points)
    monkeypatch.syspath_prepend(tmp_path)
    apart = launch("bridge.launch.py", bridge="kite", one_process="false")
    (kite,) = (node for node in apart if node.name[0] == "k")
    assert (kite.package, kite.executable) == ("kite_pilot", "kite_bridge")


def topics_of(node: rclpy.node.Node) -> set[str]:
    name, namespace = node.get_name(), node.get_namespace()
    ends = (
        *node.get_publisher_names_and_types_by_node(name, namespace),
        *node.get_subscriber_names_and_types_by_node(name, namespace),
    )
    return {topic for topic, _ in ends}


def settled(read: Callable[[], set[str]]) -> set[str]:
    """Return what is read until it has stayed the same for a while: discovery takes time."""
    before, since = read(), time.monotonic()
    while time.monotonic() - since < 0.5:
        time.sleep(0.02)
        now = read()
        if now != before:
            before, since = now, time.monotonic()
    return before


def test_remapped_topics_are_those_of_the_nodes(launch: Launch) -> None:
    """Each remapping moves a topic of a node that it is given to, in the node itself."""
    topics = {name: f"/elsewhere/{name}" for name in ("odom", "reference", "command")}
    moved: set[str] = set()
    for node in launch("mpc.launch.py", namespace="uav1", rep147="true", **topics):
        rules = [("__ns", f"/{node.namespace}"), ("__node", node.name), *node.remappings.items()]
        arguments = [part for a, b in rules for part in ("-r", f"{a}:={b}")]
        files_given = [part for each in node.parameters for part in ("--params-file", str(each))]
        rclpy.init(args=["--ros-args", *arguments, *files_given])
        made = {"mpc": MpcNode, "reference": ReferenceNode}[node.name]()
        try:
            assert made.get_fully_qualified_name() == f"/uav1/{node.name}"
            found = settled(lambda node=made: topics_of(node))
        finally:
            made.destroy_node()
            rclpy.shutdown()
            # rclpy lets go of what announces transitions only with the node itself, which the
            # node's start has kept from being collected; later tests would receive its events.
            del made
            gc.unfreeze()
            gc.collect()
        assert found & set(topics.values())
        assert not found & {f"/uav1/{topic}" for topic in topics}
        moved |= found & set(topics.values())
        if node.name == "reference":
            requests = ("command_trajectory", "command_pose", "command_velocity")
            assert {f"/uav1/{name}" for name in requests} <= found
    assert moved == set(topics.values())
