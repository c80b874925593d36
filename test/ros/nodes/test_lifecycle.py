# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of the nodes, as another process sees it over DDS."""

from __future__ import annotations

import gc
import re
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.processes import PATIENCE
from geometry_msgs.msg import PoseStamped, TwistStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.client import Client
from rclpy.event_handler import EventHandler
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_msgs.msg import Bool, Int32
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from quad_mpc_ros.control.mpc import Mpc
from quad_mpc_ros.messages.diagnostics import stats_from_message
from quad_mpc_ros.recordings.reader import BagReader
from quad_mpc_ros.recordings.repair import repair
from quad_mpc_ros.recordings.writer import BagWriter
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.recorder_node import RecorderNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode

Start = Callable[..., "subprocess.Popen[bytes]"]

WAIT = ("-p", "autostart:=false")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ACTIVATE_NUMBER = 3


class Outputs:
    """Counts what is published on the topics of the MPC."""

    def __init__(self, peer: Any) -> None:
        self._peer = peer
        self.commands: list[TwistStamped] = []
        self.stats: list[DiagnosticArray] = []
        peer.node.create_subscription(
            TwistStamped, "command", self.commands.append, qos_profile_sensor_data
        )
        peer.node.create_subscription(DiagnosticArray, "mpc/stats", self.stats.append, 10)

    def anything(self, seconds: float) -> bool:
        """Return whether something is published from now on, not counting what is on its way."""
        self._peer.spin(0.05)
        self.commands.clear()
        self.stats.clear()
        self._peer.spin(seconds)
        return bool(self.commands or self.stats)


@pytest.fixture
def outputs(peer: Any) -> Outputs:
    return Outputs(peer)


def test_mpc_commands_only_while_it_is_active(
    start: Start, peer: Any, feed: Any, outputs: Outputs, managed: Any, tmp_path: Path
) -> None:
    process, mpc = start("mpc", *WAIT), managed("mpc")
    feed.odometry = feed.reference = False
    assert mpc.state == "unconfigured"
    assert mpc.reports("unconfigured")
    assert not peer.node.count_publishers("command")

    assert not mpc.to("activate")
    assert not mpc.to(ACTIVATE_NUMBER)
    assert not mpc.to("levitate")
    assert mpc.state == "unconfigured"

    assert mpc.to("configure")
    assert mpc.reports("inactive", "no odometry yet")
    assert not mpc.to("activate")
    feed.odometry = True
    assert mpc.reports("inactive", "no reference yet")
    assert not mpc.to("activate")
    feed.reference = True
    assert peer.wait(lambda: mpc.health["text"] == "inactive")
    assert not outputs.anything(0.3), "an inactive node publishes"

    assert mpc.to("activate")
    assert outputs.anything(0.2)
    assert mpc.reports("active", "flying")

    assert mpc.to("deactivate")
    assert not outputs.anything(0.3), "a deactivated node publishes"
    feed.reference = False
    assert peer.wait(lambda: "reference is" in mpc.health["text"])
    assert not mpc.to("activate"), "the reference is stale"
    feed.reference = True
    assert peer.wait(lambda: mpc.to("activate"))
    assert outputs.anything(0.2)

    assert mpc.to("deactivate")
    assert mpc.to("cleanup")
    assert mpc.state == "unconfigured"
    assert peer.wait(lambda: not peer.node.count_publishers("command"))
    assert process.poll() is None
    log = (tmp_path / "mpc.log").read_text()
    assert "activate refused: no odometry yet" in log
    assert "activate refused: reference is" in log
    assert "transition levitate refused" in log
    assert "Traceback" not in log


def test_warns_of_a_deactivation_in_flight(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    """There is no warning if commands do not act."""
    engaged, landed = (
        peer.node.create_publisher(Bool, name, LATCHED) for name in ("engaged", "landed")
    )
    landed.publish(Bool(data=False))
    start("mpc")
    mpc, log = managed("mpc"), tmp_path / "mpc.log"
    warned = r"\[WARN\] .*inactive on request in flight: stopped publishing commands"
    for acts in (False, True):
        engaged.publish(Bool(data=acts))
        assert mpc.reports("active")
        peer.deliver(engaged, landed)
        assert peer.wait(lambda acts=acts: mpc.health.get("engaged") == str(acts).lower())
        assert mpc.to("deactivate")
        assert mpc.reports("inactive")
        assert bool(re.search(warned, log.read_text())) is acts
        assert acts or peer.wait(lambda: mpc.to("activate"))


def test_mpc_activates_automatically_with_slow_odometry_and_reference(
    start: Start, peer: Any, feed: Any, outputs: Outputs, managed: Any
) -> None:
    """Odometry that is older than odom_timeout most of the time blocks no activation for good."""
    feed.reference, feed.decimation = False, 10
    # Odometry that rests contradicts the thrust that it is given.
    start("mpc", "-p", "consistency.action:=warn")
    mpc = managed("mpc")
    assert mpc.reports("inactive", "no reference yet")
    assert not outputs.anything(0.2)
    feed.reference = True
    assert mpc.reports("active")

    def solved() -> int:
        sources = [stats_from_message(each)["source"] for each in outputs.stats]
        return sources.count("mpc")

    assert peer.wait(lambda: solved() >= 10)
    assert len(outputs.commands) >= 10

    assert mpc.to("deactivate")
    assert not outputs.anything(0.3), "it must not start by itself again"
    assert mpc.state == "inactive"


def test_parameters_may_be_set_until_configured(
    start: Start, peer: Any, managed: Any, tmp_path: Path
) -> None:
    process, mpc = start("mpc", *WAIT, "-p", "drag:=[0.2, 0.3, 0.4]"), managed("mpc")
    for drag in (0.3, [0.2, 0.3, 0.4], 1, [1, 1, 2]):
        assert mpc.set(drag=drag) == ""
    for wrong in ("much", [0.2, 0.3], -0.1, [0.2, 0.3, -0.1], True):
        assert "expected a number >= 0, or 3 numbers" in mpc.set(drag=wrong)
    assert mpc.set(horizon_steps=0) == (
        "Parameter horizon_steps out of range. Min: 1, Max: 200, value: 0"
    )
    assert "mpc.Q: given [1.0], expected 9 numbers >= 0" in mpc.set(Q=[1.0])
    for vehicles in (["uav2"], []):  # a list that was declared empty takes values, and none again
        assert mpc.set(**{"obstacles.neighbours": vehicles}) == ""
    # One after the other, of which the first alone does not go with the weight.
    assert mpc.set(throttle_max=0.29) == ""
    assert not mpc.to("configure")
    assert mpc.reports("unconfigured", "mpc.throttle_max: given 0.29, expected a number above")
    assert mpc.set(mass=0.3) == ""
    assert mpc.set(horizon_steps=7, terminal_weight=20, **{"limits.speed_max": 5.0}) == ""
    assert mpc.to("configure")

    refusal = mpc.set(throttle_min=0.1, horizon_steps=9)
    assert refusal.startswith("mpc.horizon_steps: given 9, expected 7 as long as the node is ")
    assert "clean up the node first" in refusal
    assert mpc.set(drag=0.2).startswith("mpc.drag: given 0.2, expected [1.0, 1.0, 2.0] as long")
    same = {"horizon_steps": 7, "mass": 0.3, "drag": [1, 1, 2]}
    assert mpc.set(**same, throttle_min=0.1) == "", "what is the same is fine"
    assert mpc.set(**{"limits.speed_max": 4.0}) == "", "on since it was configured"
    assert "mpc.massa: given 2.0" in (unknown := mpc.set(massa=2.0))
    assert "did you mean mass?" in unknown
    refusal = mpc.set(**{"limits.speed_max": 0.0})
    assert refusal.startswith(
        "mpc.limits.speed_max: given 0.0, expected not 0 as long as the node"
    )
    assert "hover throttle" in mpc.set(throttle_min=0.25, throttle_max=0.5)

    assert mpc.to("cleanup")
    assert mpc.set(horizon_steps=9) == ""
    assert mpc.to("configure")
    assert process.poll() is None
    log = (tmp_path / "mpc.log").read_text()
    assert "configure refused: mpc.throttle_max: given 0.29" in log
    assert "changed: limits.speed_max 5.0 to 4.0" in log
    assert "Traceback" not in log


def test_a_shutdown_from_every_state_ends_the_process(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    steps = {"mpc": ("configure", "activate"), "reference": ("configure",), "recorder": ()}
    processes = {name: start(name, *WAIT) for name in steps}
    for name, transitions in steps.items():
        node = managed(name)
        for each in transitions:
            assert peer.wait(lambda node=node, each=each: node.to(each)), each
        assert node.to("shutdown")
        assert processes[name].wait(PATIENCE) == 0
        assert "Traceback" not in (tmp_path / f"{name}.log").read_text()


GOALS = {
    Transition.TRANSITION_CONFIGURE: "inactive",
    Transition.TRANSITION_ACTIVATE: "active",
    Transition.TRANSITION_DEACTIVATE: "inactive",
    Transition.TRANSITION_CLEANUP: "unconfigured",
}


def manage(nodes: list[Any], *transitions: int) -> bool:
    """Ask as ``nav2_lifecycle_manager`` with ``bond_timeout: 0.0``: by number, then the state."""
    return all(
        node.to(each) and node.state == GOALS[each] for each in transitions for node in nodes
    )


def test_nav2_lifecycle_manager_starts_resets_and_shuts_down(
    start: Start, peer: Any, feed: Any, managed: Any, tmp_path: Path
) -> None:
    """The MPC activates by itself, for its inputs arrive after the manager's last transition."""
    feed.reference = False
    processes = [
        start("reference", *WAIT),
        start("recorder", *WAIT, "-p", f"directory:={tmp_path / 'bag'}"),
    ]
    start("mpc")
    nodes, mpc = [managed("reference"), managed("recorder")], managed("mpc")
    up = (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    down = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    assert manage(nodes, *up)
    assert mpc.reports("active")
    assert manage(nodes[::-1], *down)
    shutil.rmtree(tmp_path / "bag")
    assert manage(nodes, *up)
    assert manage(nodes[::-1], *down)
    for node in nodes[::-1]:
        assert node.to(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert [process.wait(PATIENCE) for process in processes] == [0, 0]
    assert mpc.state == "active"


# --- the reference


def test_reference_continues_where_it_stopped(start: Start, peer: Any, managed: Any) -> None:
    """On a circle of 2 m at 2 m/s, a jump by the second of the pause would be 1.9 m."""
    windows: list[MultiDOFJointTrajectory] = []
    paths: list[PathMessage] = []
    peer.node.create_subscription(MultiDOFJointTrajectory, "reference", windows.append, 10)
    peer.node.create_subscription(PathMessage, "reference/path", paths.append, LATCHED)
    odometry = peer.node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
    goal = peer.node.create_publisher(PoseStamped, "goal_pose", 1)
    hold = peer.node.create_client(Trigger, "reference/hold")

    def position() -> np.ndarray:
        translation = windows[-1].points[0].transforms[0].translation
        return np.array([translation.x, translation.y, translation.z])

    start("reference", *WAIT, "-p", "trajectory:=circle")
    reference = managed("reference")
    assert reference.to("configure")
    assert peer.wait(odometry.get_subscription_count)
    assert peer.wait(goal.get_subscription_count)
    refused = peer.call(hold, Trigger.Request())
    assert not refused.success
    assert "inactive" in refused.message
    goal.publish(PoseStamped())
    peer.spin(0.2)
    assert not windows
    assert not paths

    assert reference.to("activate")
    assert peer.wait(lambda: windows and paths)
    message = Odometry()
    message.header.frame_id = "odom"
    message.header.stamp = peer.node.get_clock().now().to_msg()
    message.pose.pose.orientation.w = 1.0
    odometry.publish(message)
    beginning = position()
    assert peer.wait(lambda: np.linalg.norm(position() - beginning) > 0.3)

    assert reference.to("deactivate")
    peer.spin(0.05)
    windows_before, last = len(windows), position()
    peer.spin(1.0)
    assert len(windows) == windows_before, "an inactive node publishes"

    assert reference.to("activate")
    assert peer.wait(lambda: len(windows) > windows_before)
    # A window comes every so often, from the place where the vehicle is to be then.
    assert np.linalg.norm(position() - last) < 1.0, "it has jumped ahead"
    assert peer.wait(lambda: np.linalg.norm(position() - last) > 0.3), "it goes on"
    assert reference.reports("active", "flying")


def test_reference_reconfigures_with_another_trajectory(
    start: Start, peer: Any, managed: Any
) -> None:
    windows: list[MultiDOFJointTrajectory] = []
    peer.node.create_subscription(MultiDOFJointTrajectory, "reference", windows.append, 10)
    start("reference")
    reference = managed("reference")
    assert reference.reports("active")
    assert "expected 'square' as long as" in reference.set(trajectory="hover")
    assert reference.to("deactivate")
    assert reference.to("cleanup")
    assert reference.set(trajectory="csv", file="/nowhere.csv") == ""
    assert not reference.to("configure")
    assert reference.reports("unconfigured", "/nowhere.csv")
    assert reference.set(trajectory="hover", height=3.5) == ""
    assert reference.to("configure")
    windows.clear()
    assert reference.to("activate")
    assert peer.wait(lambda: windows)
    assert windows[-1].points[0].transforms[0].translation.z == 3.5


# --- the recorder


@pytest.fixture
def counter(peer: Any) -> Iterator[Callable[[int], None]]:
    """Return a function that publishes a count of consecutive numbers."""
    publisher = peer.node.create_publisher(Int32, "/numbers", 100)
    count = 0

    def publish(more: int) -> None:
        nonlocal count
        for _ in range(more):
            publisher.publish(Int32(data=count))
            count += 1
            peer.spin(0.005)
        if publisher.get_subscription_count():
            peer.deliver(publisher)

    publish.subscribers = publisher.get_subscription_count  # type: ignore[attr-defined]
    return publish


def _recorded(bag: Path) -> list[int]:
    """Return the numbers in a bag; CDR is four bytes of header, then the number."""
    return [int.from_bytes(m.data[4:8], "little") for m in BagReader(bag).messages(["/numbers"])]


def test_recorder_pauses_and_resumes_in_one_bag(
    start: Start, peer: Any, managed: Any, counter: Any, tmp_path: Path
) -> None:
    bag, other = tmp_path / "bag", tmp_path / "other"
    latched = peer.node.create_publisher(Int32, "/latched", LATCHED)
    start(
        "recorder",
        *WAIT,
        *("-p", f"directory:={bag}", "-p", "topics:=[/numbers, /latched]"),
    )
    recorder = managed("recorder")
    assert recorder.to("configure")
    counter(5)
    latched.publish(Int32(data=1))
    assert not bag.exists(), "nothing on the disk before it records"

    assert recorder.to("activate")
    assert peer.wait(counter.subscribers)
    counter(10)  # 5 to 14
    assert recorder.to("deactivate")
    assert not (bag / "metadata.yaml").exists()
    repair(shutil.copytree(bag, tmp_path / "copied"))
    assert _recorded(tmp_path / "copied") == list(range(5, 15)), "what was recorded is on the disk"
    counter(10)  # 15 to 24, which are not recorded
    assert recorder.to("activate")
    assert peer.wait(counter.subscribers)
    counter(10)  # 25 to 34
    assert recorder.to("deactivate")
    assert recorder.to("cleanup")
    assert (bag / "metadata.yaml").exists()
    assert _recorded(bag) == [*range(5, 15), *range(25, 35)]
    assert [m.topic for m in BagReader(bag).messages(["/latched"])]

    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    assert not recorder.to("configure")
    assert recorder.reports("unconfigured", "exists already")
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    assert recorder.set(directory=str(other)) == ""
    assert recorder.to("configure")
    other.mkdir()
    assert not recorder.to("activate")
    assert recorder.reports("inactive", "exists already")
    other.rmdir()
    assert recorder.to("activate")
    assert peer.wait(counter.subscribers)
    counter(5)
    assert recorder.to("shutdown")
    assert peer.wait(lambda: (other / "metadata.yaml").exists())
    assert _recorded(other) == list(range(35, 40))


# --- again and again

CYCLE = ("configure", "activate", "deactivate", "cleanup")


@pytest.fixture
def unfrozen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Hide from the garbage collector what exists before the test, and nothing after that."""
    monkeypatch.setattr("quad_mpc_ros.ros.lifecycle.freeze_gc", lambda: None)
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("unfrozen")
@pytest.mark.parametrize("kind", [MpcNode, ReferenceNode, RecorderNode])
def test_cleanup_releases_everything(
    kind: type[Any], peer: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test counts all objects of this process, so that not even a timer can leak."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(kind, "start", lambda _: None)
    monkeypatch.setattr(kind, "activation_blocker", lambda _: None)
    node = kind()
    made = (Publisher, Subscription, Service, Client, Timer, EventHandler, BagWriter, Mpc)

    def living() -> dict[str, int]:
        gc.collect()
        found = [o for o in gc.get_objects() if isinstance(o, made)]
        return {each.__name__: sum(isinstance(o, each) for o in found) for each in made}

    def owned() -> list[int]:
        entities = (node.publishers, node.subscriptions, node.services, node.clients, node.timers)
        return [len(list(each)) for each in entities]

    owned_before, living_before = owned(), living()
    for number in range(4):
        for transition in CYCLE:
            getattr(node, f"trigger_{transition}")()
            if transition == "activate":
                assert living() != living_before
        assert owned() == owned_before
        if number == 0:
            # The node's attributes name endpoints that are destroyed, until it makes new ones.
            living_before = living()
    assert living() == living_before
    node.destroy_node()


@pytest.mark.usefixtures("unfrozen")
def test_failing_transition_keeps_node_and_leaks_nothing(
    peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same holds for requests of other nodes, through rclpy's own state machine."""

    def broken(_: Any, __: Any) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr(ReferenceNode, "start", lambda _: None)
    node = ReferenceNode()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReferenceNode, "_publish_path", broken)
        node.trigger_configure()
        made = threading.active_count(), len(list(node.subscriptions))
        node.trigger_activate()
        assert node.state == "unconfigured"
        assert threading.active_count() < made[0]
        assert len(list(node.subscriptions)) < made[1]
    node.trigger_configure()
    node.trigger_activate()
    assert node.state == "active"
    node.destroy_node()
