# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From a bag to a flight, with bags made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quad_mpc_ros.configuration import BagError, UserError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.verdict import verdict_on
from quad_mpc_ros.recordings.flight import Flight, ReferenceSampler
from quad_mpc_ros.recordings.recording import Recording

HOVER_THROTTLE = 0.2923008  # of the paper's vehicle
HALF = np.sqrt(0.5)

BagStarter = Callable[..., Any]


def read(bag: Any) -> Flight:
    """End a bag and read it."""
    bag.writer.close()
    return Recording(bag.writer.directory).flight()


@pytest.mark.parametrize("namespace", ["", "/uav1", "/fleet/uav1"])
def test_reads_everything_back(
    make_bag: BagStarter, build: SimpleNamespace, namespace: str
) -> None:
    random = np.random.default_rng(1)
    bag = make_bag(namespace=namespace)
    stamps = [build.start_ns + n * build.period_ns for n in range(4)]
    flown = [
        build.odometry(
            stamp,
            p_WB=random.normal(size=3),
            q_WB_xyzw=np.array([0.0, 0.6, 0.0, -0.8]),
            v_WB_B=random.normal(size=3),
            w_WB_B=random.normal(size=3),
        )
        for stamp in stamps
    ]
    commands = [
        CommandSample(stamp_ns=stamp, throttle=random.uniform(), w_WB_B=random.normal(size=3))
        for stamp in stamps
    ]
    for n, stamp in enumerate(stamps):
        bag.odometry(flown[n], latency_ms=0.5)
        bag.reference(build.window(stamp, [1.0 * n, 2.0, 3.0]))
        bag.command(commands[n], latency_ms=2.5)
        bag.tick(build.tick(stamp, iterations=25 * n, step_time_us=0.1 * n, reason="a reason"))
    bag.parameters("mpc", {"mass": 0.5, "control_rate": 40.0, "use_sim_time": True})

    flight = read(bag)
    assert flight.stamp_ns.tolist() == stamps
    assert flight.publish_time_ns.tolist() == [stamp + 500_000 for stamp in stamps]
    assert flight.time == pytest.approx([0.0, 0.02, 0.04, 0.06])
    for name in ("p_WB", "q_WB_xyzw", "v_WB_B", "w_WB_B"):
        assert np.array_equal(getattr(flight, name), [getattr(one, name) for one in flown])
    assert flight.reference is not None
    assert flight.reference.p_WB[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert flight.commands.stamp_ns.tolist() == stamps
    assert flight.commands.publish_time_ns.tolist() == [stamp + 2_500_000 for stamp in stamps]
    assert flight.commands.throttle.tolist() == [one.throttle for one in commands]
    assert np.array_equal(flight.commands.w_WB_B, [one.w_WB_B for one in commands])
    assert flight.stats["iterations"].tolist() == [0, 25, 50, 75]
    assert flight.stats["iterations"].dtype == np.int64
    assert flight.stats["step_time_us"].tolist() == [0.1 * n for n in range(4)]
    assert flight.stats["reason"].tolist() == ["a reason"] * 4
    assert flight.parameters["mpc"]["use_sim_time"] is True
    assert (flight.mpc.mass, flight.mpc.control_rate) == (0.5, 40.0)


def test_reads_a_bag_with_odometry_only(make_bag: BagStarter, build: SimpleNamespace) -> None:
    bag = make_bag()
    bag.odometry(build.odometry(build.start_ns))
    flight = read(bag)
    assert flight.reference is None
    assert flight.commands.w_WB_B.shape == (0, 3)
    assert len(flight.stats["iterations"]) == 0
    assert flight.parameters == {}
    assert flight.mpc == MpcConfig()


class TestReference:
    def test_the_last_window_stamped_no_later_is_in_force(self, build: SimpleNamespace) -> None:
        """Against the definition; one sent again after a newer one changes nothing."""
        random = np.random.default_rng(3)
        for _ in range(50):
            stamps = np.unique(random.integers(0, 60, 25))
            starts = sorted(random.choice(np.arange(5, 55), 12, replace=False).tolist())
            windows = [build.window(s, [float(i), 0.0, 0.0]) for i, s in enumerate(starts)]
            sampler = ReferenceSampler(stamps, MpcConfig().vehicle())
            for window in windows:
                sampler.take(window)
                sampler.take(windows[0])
            track = sampler.track()
            assert track is not None
            for stamp, x in zip(stamps.tolist(), track.p_WB[:, 0].tolist(), strict=True):
                begun = [i for i, start in enumerate(starts) if start <= stamp]
                assert x == (begun[-1] if begun else 0)

    def test_reference_is_sampled_at_the_odometry(
        self, make_bag: BagStarter, build: SimpleNamespace
    ) -> None:
        bag, start = make_bag(), build.start_ns
        east = np.array([[2.0, 0.0, 0.0]] * 2)
        # Nose to the north, and lifting it: turning about the east.
        north = Rotation.from_quat([0.0, 0.0, HALF, HALF])
        rolled = Rotation.from_rotvec([0.2, 0.0, 0.0]) * north
        window = build.window(
            start,
            [0.0, 0.0, 0.0],
            p_WB=np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0]]),
            v_WB_W=east,
            w_WB_W=np.array([[0.1, 0.0, 0.0]] * 2),
            q_WB_xyzw=np.stack([north.as_quat(), rolled.as_quat()]),
        )
        bag.reference(window)
        bag.odometry(build.odometry(start + 500_000_000))
        reference = read(bag).reference
        assert reference is not None
        assert reference.p_WB == pytest.approx(np.array([[1.0, 0.0, 1.0]]))
        # Flying east with the nose to the north is flying to the right, and left is positive.
        assert reference.v_WB_B == pytest.approx(np.array([[0.0, -2.0, 0.0]]))
        assert reference.w_WB_B == pytest.approx(np.array([[0.0, -0.1, 0.0]]))
        nose = [0.0, np.cos(0.05), np.sin(0.05)]
        assert reference.R_WB[0] @ [1.0, 0.0, 0.0] == pytest.approx(nose)

    @pytest.mark.parametrize("recorded", [True, False])
    def test_reference_throttle_is_the_vehicles(
        self, make_bag: BagStarter, build: SimpleNamespace, recorded: bool
    ) -> None:
        bag, start = make_bag(), build.start_ns
        if recorded:
            # A linear curve: 4 N at full throttle, and a weight of 1 N.
            bag.parameters(
                "/uav1/mpc", {"mass": 0.1, "gravity": 10.0, "thrust_curve": [0.0, 1.0, 0.0]}
            )
        bag.odometry(build.odometry(start))
        bag.reference(build.window(start, [0.0, 0.0, 2.0]))
        reference = read(bag).reference
        assert reference is not None
        expected = 0.25 if recorded else HOVER_THROTTLE
        assert reference.throttle == pytest.approx([expected], abs=1e-7)

    def test_skips_an_unusable_window(self, make_bag: BagStarter, build: SimpleNamespace) -> None:
        bag, start = make_bag(), build.start_ns
        bag.reference(build.window(start, [1.0, 0.0, 0.0]))
        bag.reference(build.window(start + 1, [np.nan, 0.0, 0.0]))
        bag.empty("reference", "trajectory_msgs/msg/MultiDOFJointTrajectory", start + 2)
        bag.odometry(build.odometry(start + 20))
        reference = read(bag).reference
        assert reference is not None
        assert reference.p_WB.tolist() == [[1.0, 0.0, 0.0]]


def test_skips_unusable_odometry(make_bag: BagStarter, build: SimpleNamespace) -> None:
    bag, start = make_bag(), build.start_ns
    bag.odometry(build.odometry(start))
    bag.odometry(build.odometry(start + 10, p_WB=np.array([np.nan, 0.0, 0.0])))
    bag.odometry(build.odometry(start + 20, q_WB_xyzw=np.zeros(4)))
    bag.odometry(build.odometry(start + 30))
    flight = read(bag)
    assert flight.stamp_ns.tolist() == [start, start + 30]
    reason = "odometry pose.pose.position.x is not finite or beyond 1e8"
    assert flight.rejected == {reason: 1, "odometry quaternion does not have unit length": 1}
    assert f"Odometries that the controller rejects: 1, {reason}." in wrong(flight)


def test_names_odometry_in_another_frame_than_the_controllers(
    make_bag: BagStarter, build: SimpleNamespace
) -> None:
    for frame_id, is_recorded in (("odom", True), ("map", True), ("map", False)):
        bag = make_bag(f"{frame_id}_{is_recorded}")
        for n in range(3):
            bag.odometry(build.odometry(build.start_ns + n * build.period_ns, frame_id=frame_id))
        if is_recorded:
            bag.parameters("mpc", {"mass": 0.5})
        flight = read(bag)
        assert len(flight.stamp_ns) == 3
        named = "rejects: 3, odometry is in frame 'map', expected 'odom'."
        assert any(named in sentence for sentence in wrong(flight)) is (
            frame_id == "map" and is_recorded
        )


def wrong(flight: Flight) -> Sequence[str]:
    return verdict_on(summarise(flight)).wrong


def test_rotates_a_world_frame_twist(make_bag: BagStarter, build: SimpleNamespace) -> None:
    bag = make_bag()
    bag.parameters("mpc", {"odometry.twist_frame": "world"})
    bag.odometry(
        build.odometry(
            build.start_ns,
            q_WB_xyzw=np.array([0.0, 0.0, HALF, HALF]),  # nose to the north
            v_WB_B=np.array([0.0, 3.0, 0.0]),
            w_WB_B=np.array([1.0, 0.0, 2.0]),
        )
    )
    flight = read(bag)
    assert flight.v_WB_B == pytest.approx(np.array([[3.0, 0.0, 0.0]]))
    assert flight.w_WB_B == pytest.approx(np.array([[0.0, -1.0, 2.0]]))


def test_flight_ends_with_the_last_odometry(make_bag: BagStarter, build: SimpleNamespace) -> None:
    bag, start = make_bag(), build.start_ns
    for n, source in enumerate(("mpc", "plan", "mpc", "hover", "blind")):
        stamp = start + n * build.period_ns
        if n < 3:
            bag.odometry(build.odometry(stamp))
        bag.tick(build.tick(stamp, source=source))
        bag.command(CommandSample(stamp_ns=stamp, throttle=0.3, w_WB_B=np.zeros(3)))
    flight = read(bag)
    assert flight.stats["source"].tolist() == ["mpc", "plan", "mpc"]
    summary = summarise(flight, wall_seconds=None)
    assert (summary["commands"], summary["fallbacks"]) == (3, 1)


def test_first_of_repeated_messages_counts(make_bag: BagStarter, build: SimpleNamespace) -> None:
    bag, start = make_bag(), build.start_ns
    for latency_ms in (0.0, 200.0):
        bag.odometry(build.odometry(start), latency_ms=latency_ms)
    for latency_ms in (201.0, 202.0):
        bag.command(
            CommandSample(stamp_ns=start, throttle=0.3, w_WB_B=np.zeros(3)), latency_ms=latency_ms
        )
        bag.tick(build.tick(start, source="plan"))
    summary = summarise(read(bag), wall_seconds=None)
    assert (summary["odometries"], summary["commands"], summary["fallbacks"]) == (1, 1, 1)
    assert summary["odom_to_command_ms"]["max"] == pytest.approx(201.0)


class TestRefusals:
    @staticmethod
    def refusal(bag: Any) -> str:
        """Return the one line with which a bag is refused."""
        with pytest.raises(UserError) as caught:
            read(bag)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    def test_no_odometry(self, make_bag: BagStarter, build: SimpleNamespace) -> None:
        bag = make_bag()
        bag.reference(build.window(build.start_ns, [0.0, 0.0, 0.0]))
        assert "no flight: expected" in self.refusal(bag)

    def test_no_usable_odometry(self, make_bag: BagStarter, build: SimpleNamespace) -> None:
        bag = make_bag()
        bag.odometry(build.odometry(build.start_ns, v_WB_B=np.array([0.0, np.inf, 0.0])))
        refusal = self.refusal(bag)
        assert "no flight: expected" in refusal
        assert "1 rejected: odometry twist.twist.linear.y is not finite or beyond 1e8" in refusal

    def test_two_vehicles(self, make_bag: BagStarter, build: SimpleNamespace) -> None:
        bag = make_bag(namespace="/uav1")
        bag.odometry(build.odometry(build.start_ns))
        bag.empty("/uav2/odom", "nav_msgs/msg/Odometry", build.start_ns)
        assert "/uav1/odom, /uav2/odom" in self.refusal(bag)

    def test_ignores_topics_of_other_types_or_names(
        self, make_bag: BagStarter, build: SimpleNamespace
    ) -> None:
        bag = make_bag(namespace="/uav1")
        bag.odometry(build.odometry(build.start_ns))
        bag.empty("/other/odom", "geometry_msgs/msg/TwistStamped", build.start_ns)
        bag.empty("/visual_odom", "nav_msgs/msg/Odometry", build.start_ns)
        bag.writer.add_topic("/silent/odom", "nav_msgs/msg/Odometry")
        assert read(bag).stamp_ns.tolist() == [build.start_ns]

    def test_refuses_stats_of_another_package(
        self, make_bag: BagStarter, build: SimpleNamespace
    ) -> None:
        bag = make_bag()
        bag.odometry(build.odometry(build.start_ns))
        bag.empty("mpc/stats", "diagnostic_msgs/msg/DiagnosticArray", build.start_ns)
        assert "mpc/stats" in self.refusal(bag)

    def test_refuses_impossible_parameters(
        self, make_bag: BagStarter, build: SimpleNamespace
    ) -> None:
        bag = make_bag()
        bag.parameters("mpc", {"mass": -1.0})
        bag.odometry(build.odometry(build.start_ns))
        assert "mpc.mass" in self.refusal(bag)


@pytest.mark.parametrize("stamp_ns", [0, 1_700_000_000_000_000_000])
def test_rejects_odometry_whose_stamps_do_not_advance(
    stamp_ns: int, make_bag: BagStarter, build: SimpleNamespace
) -> None:
    bag = make_bag()
    for count in range(100):
        bag.odometry(build.odometry(stamp_ns), latency_ms=20.0 * count)
    with pytest.raises(BagError, match="stamps do not advance: given 100 odometries with 1 diff"):
        read(bag)
