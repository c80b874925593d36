# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The obstacles in a world after messages of all kinds; invalid messages are not fatal."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fixtures.interleaving import interleaved
from fixtures.messages import encoded

from quad_mpc_ros.control.config import ObstacleParameters
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.extras.obstacles import clouds, frames, local_map, markers
from quad_mpc_ros.extras.obstacles import world as world_module
from quad_mpc_ros.extras.obstacles.files import scene_of
from quad_mpc_ros.extras.obstacles.local_map import LocalMapProvider
from quad_mpc_ros.extras.obstacles.voxels import VoxelMap
from quad_mpc_ros.extras.obstacles.world import ObstacleWorld
from quad_mpc_ros.messages.markers import filled_marker
from quad_mpc_ros.messages.obstacle_messages import (
    ADD,
    CUBE,
    CYLINDER,
    DELETE,
    DELETEALL,
    SPHERE,
    Marker,
    TimedPath,
    Transform,
    markers_from_message,
)
from quad_mpc_ros.messages.point_cloud import (
    PointCloud,
    point_cloud_from_message,
    written_point_cloud,
    written_records,
)
from quad_mpc_ros.messages.topics import OBSTACLE_MARKERS, OBSTACLES
from quad_mpc_ros.ros.messages import message_in, new_message

SECOND = 1_000_000_000
HERE = np.zeros(3)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def world(scene: Any = None, **parameters: Any) -> ObstacleWorld:
    config = ObstacleParameters(**{"half_spaces": 8, **parameters})
    return ObstacleWorld(config, None if scene is None else scene_of(scene, "test"))


def at(stamp_ns: int, p_WB: Any = (0.0, 0.0, 1.0), *, yaw: float = 0.0) -> OdometrySample:
    return OdometrySample.at_rest(p_WB, yaw=yaw, stamp_ns=stamp_ns)


def cloud(points: Any, stamp_ns: int, frame_id: str = "odom") -> PointCloud:
    p_SQ = np.array(points, dtype=np.float32).reshape(-1, 3)
    return PointCloud(stamp_ns=stamp_ns, frame_id=frame_id, p_SQ=p_SQ)


def marker(number: int = 1, **fields: Any) -> Marker:
    base = Marker(
        stamp_ns=SECOND,
        frame_id="odom",
        name=("things", number),
        kind=CUBE,
        action=ADD,
        p=np.array([3.0, 0.0, 1.0]),
        q_xyzw=LEVEL,
        scale=np.array([0.4, 0.4, 2.0]),
        lifetime_ns=0,
        points=np.zeros((0, 3)),
    )
    return dataclasses.replace(base, **fields)


def known(of: ObstacleWorld, stamp_ns: int, *, near: Array = HERE, radius: float = 20.0) -> Array:
    """Return what stands by the time of an odometry."""
    of.receive_odometry(at(stamp_ns))
    return of.points(stamp_ns, near=near, radius=radius)


class TestFrames:
    def test_pose_is_interpolated_between_odometries(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND, (0.0, 0.0, 1.0), yaw=0.0))
        w.receive_odometry(at(SECOND + 10**8, (1.0, 0.0, 1.0), yaw=1.0))
        w.receive_cloud(cloud([[1, 0, 0]], SECOND + 5 * 10**7, "base_link"))
        expected = np.array([[0.5 + math.cos(0.5), math.sin(0.5), 1.0]])
        assert known(w, SECOND + 10**8) == pytest.approx(expected, abs=1e-6)

    def test_camera_pose_follows_a_chain_of_transforms(self) -> None:
        """An optical frame: z ahead, x right, y down."""
        w = world()
        w.receive_odometry(at(SECOND, (0.0, 0.0, 1.0), yaw=math.pi / 2))
        R = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        optical = so3.quaternion_xyzw_from_rotation(R)
        w.receive_transforms(
            [
                Transform(
                    stamp_ns=0,
                    parent="base_link",
                    child="camera",
                    p=np.array([0.1, 0.0, 0.0]),
                    q_xyzw=LEVEL,
                ),
                Transform(
                    stamp_ns=0, parent="camera", child="optical", p=np.zeros(3), q_xyzw=optical
                ),
            ]
        )
        w.receive_cloud(cloud([[0.5, 0.25, 2.0]], SECOND, "optical"))
        expected = np.array([[0.5, 2.1, 0.75]])
        assert known(w, SECOND) == pytest.approx(expected, abs=1e-6)

    def test_map_frame_above_odometry_is_resolved(self) -> None:
        """``map`` is the parent of ``odom``: the transform is used the other way round."""
        w = world()
        w.receive_odometry(at(SECOND))
        shift = np.array([10.0, 0.0, 0.0])
        w.receive_transforms(
            [Transform(stamp_ns=0, parent="map", child="odom", p=shift, q_xyzw=LEVEL)]
        )
        w.receive_cloud(cloud([[11, 2, 3]], SECOND, "map"))
        assert known(w, SECOND) == pytest.approx(np.array([[1.0, 2.0, 3.0]]))

    def test_circular_transforms_end(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_transforms(
            [
                Transform(stamp_ns=0, parent="a", child="b", p=HERE, q_xyzw=LEVEL),
                Transform(stamp_ns=0, parent="b", child="a", p=HERE, q_xyzw=LEVEL),
            ]
        )
        with pytest.raises(ValueError, match="frame 'a', expected one of odom, base_link"):
            w.receive_cloud(cloud([[1, 2, 3]], SECOND, "a"))

    def test_rejects_invalid_transforms(self) -> None:
        with pytest.raises(ValueError, match="'b': not a rigid transform"):
            world().receive_transforms(
                [Transform(stamp_ns=0, parent="a", child="b", p=HERE, q_xyzw=np.zeros(4))]
            )


class TestClouds:
    @pytest.mark.parametrize(
        ("sent", "reason"),
        [
            (cloud([[1, 2, 3]], 5 * SECOND, "nowhere"), "frame 'nowhere'"),
            (cloud([[1, 2, 3]], 0), "stamped 5.000 s before the newest odometry"),
            (cloud([[1, 2, 3]], 7 * SECOND, "base_link"), "2.000 s after the newest odometry"),
        ],
    )
    def test_unusable_clouds_are_rejected_without_effect(
        self, sent: PointCloud, reason: str
    ) -> None:
        w = world()
        w.receive_odometry(at(5 * SECOND))
        before = w.revision
        with pytest.raises(ValueError, match=reason):
            w.receive_cloud(sent)
        assert w.revision == before and not len(known(w, 5 * SECOND))

    def test_clouds_are_rejected_before_the_first_odometry(self) -> None:
        with pytest.raises(ValueError, match="without odometry"):
            world().receive_cloud(cloud([[1, 2, 3]], SECOND))

    def test_scan_points_expire_unless_detected_again(self) -> None:
        w = world(forget_after=0.5)
        w.receive_odometry(at(SECOND))
        w.receive_cloud(cloud([[1, 0, 1], [2, 0, 1]], SECOND))
        later = SECOND + 4 * 10**8
        w.receive_odometry(at(later))
        w.receive_cloud(cloud([[2.0, 0.0, 1.0], [3, 0, 1]], later))
        assert sorted(known(w, later)[:, 0]) == [1.0, 2.0, 3.0]
        revision = w.revision
        assert sorted(known(w, SECOND + 6 * 10**8)[:, 0]) == [2.0, 3.0]
        assert w.revision > revision
        assert not len(known(w, later + SECOND))

    def test_a_map_replaces_the_previous_map_and_never_expires(self) -> None:
        w = world(clouds="map")
        w.receive_odometry(at(100 * SECOND))
        w.receive_cloud(cloud([[1, 0, 1]], SECOND))  # whenever it was made
        w.receive_cloud(cloud([[50, 0, 1]], 2 * SECOND))
        assert known(w, 10**6 * SECOND, radius=100.0).tolist() == [[50.0, 0.0, 1.0]]
        assert w.age(10**6 * SECOND) == w.silence(10**6 * SECOND) == 0.0

    def test_age_and_silence_count_from_the_newest_scan(self) -> None:
        w = world(forget_after=0.5)
        assert w.age(SECOND) == w.silence(SECOND) == 0.0
        w.receive_odometry(at(SECOND))
        w.receive_cloud(cloud([], SECOND))  # it saw nothing, but it looked
        assert w.age(SECOND + 3 * 10**8) == pytest.approx(0.3)
        assert w.age(3 * SECOND) == 0.0  # of what is forgotten nothing is old
        assert w.silence(3 * SECOND) == pytest.approx(2.0)

    def test_setting_the_clock_back_drops_clouds(self) -> None:
        w = world()
        w.receive_odometry(at(1000 * SECOND))
        w.receive_odometry(at(SECOND))
        w.receive_cloud(cloud([[1, 2, 3]], SECOND, "base_link"))
        assert len(known(w, SECOND)) == 1

    def test_invalid_odometry_is_ignored(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_odometry(at(SECOND + 10**7, (math.nan, 0.0, 1.0)))
        w.receive_cloud(cloud([[1, 0, 0]], SECOND + 10**7, "base_link"))
        assert np.isfinite(known(w, SECOND)).all()

    def test_points_are_all_those_within_the_radius(self) -> None:
        random = np.random.default_rng(5)
        w = world(range=50.0, resolution=0.01)
        w.receive_odometry(at(SECOND))
        points = random.uniform(-10, 10, (3000, 3)).astype(np.float32)
        w.receive_cloud(cloud(points, SECOND))
        for _ in range(50):
            near, radius = random.uniform(-9, 9, 3), float(random.uniform(0.5, 4.0))
            within = points[np.linalg.norm(points - near, axis=1) <= radius]
            found = {tuple(p) for p in known(w, SECOND, near=near, radius=radius)}
            assert {tuple(p) for p in within.astype(float)} <= found

    @pytest.mark.parametrize("clouds", ["scan", "map"])
    @pytest.mark.parametrize("turn", [0.0, 0.5 * math.pi])
    def test_odometry_jump_transforms_received_obstacles(self, clouds: str, turn: float) -> None:
        """Maps and markers may be published once: what is forgotten never comes again."""
        reset = EstimateReset(stamp_ns=SECOND + 1, turn=turn, step_W=np.array([2000.0, 3.0, 0.5]))
        here, ahead = reset.points(HERE), {"near": reset.points(HERE), "radius": 20.0}
        w = world(clouds=clouds)
        w.receive_odometry(at(SECOND))
        w.receive_cloud(cloud([[3, 0, 1], [4, 1, 2]], SECOND))
        w.receive_markers([marker(), marker(2, p=np.array([5.0, 0.0, 1.0]))])
        w.receive_markers([marker(2, stamp_ns=SECOND + SECOND // 2, p=np.array([5.5, 0.0, 1.0]))])
        before, (moving,) = known(w, SECOND), w._markers.moving(SECOND)
        w.reset_estimate(reset)
        w.receive_odometry(at(SECOND + 1, here, yaw=turn))
        after, (moved,) = w.points(SECOND + 1, **ahead), w._markers.moving(SECOND)
        assert after == pytest.approx(reset.points(before), abs=2e-4)
        assert moved.shape.p_WO == pytest.approx(reset.points(moving.shape.p_WO))
        assert moved.shape.v_WO_W == pytest.approx(reset.vectors(np.array([1.0, 0.0, 0.0])))

    def test_odometry_jump_keeps_obstacles_of_the_file(self) -> None:
        w = world({"obstacles": [{"shape": "sphere", "position": [1, 1, 1], "radius": 0.1}]})
        w.reset_estimate(EstimateReset(stamp_ns=0, turn=0.0, step_W=np.array([5.0, 0.0, 0.0])))
        x = known(w, SECOND)[:, 0]
        assert x.min() > 0.8 and x.max() < 1.2


UTM = np.array([500_000.0, 5_400_000.0, 0.0])


@pytest.mark.parametrize("clouds", ["scan", "map"])
@pytest.mark.parametrize("frame_id", ["odom", "base_link"])
def test_clouds_in_utm_coordinates_are_placed_to_a_millimetre(clouds: str, frame_id: str) -> None:
    w, ahead = world(clouds=clouds), np.array([[1.23, 0.37, 0.11], [2.71, -0.63, 0.42]])
    w.receive_odometry(at(SECOND, UTM))
    wide = ahead if frame_id == "base_link" else ahead + UTM
    w.receive_cloud(PointCloud(stamp_ns=SECOND, frame_id=frame_id, p_SQ=wide))
    found = w.points(SECOND, near=UTM, radius=20.0)
    assert found == pytest.approx(ahead + UTM, abs=1e-3)
    local = LocalMapProvider(w).at(UTM, SECOND, radius=6.0, far=1.0)
    assert local.distances(ahead + UTM).max() < 1e-3


def test_a_cloud_of_64_bit_utm_coordinates_is_read() -> None:
    points = np.array([tuple(UTM)], dtype=[(axis, "<f8") for axis in "xyz"])
    data = written_records(points, stamp_ns=SECOND, frame_id="odom")
    assert point_cloud_from_message(message_in(OBSTACLES, data)).p_SQ == pytest.approx(UTM[None])


class TestVoxels:
    def test_keeps_the_newest_point_per_voxel(self) -> None:
        random = np.random.default_rng(6)
        kept = VoxelMap(0.25)
        last: dict[tuple[int, ...], tuple[float, ...]] = {}
        for number in range(6):
            points = random.normal(scale=2.0, size=(4000, 3)).astype(np.float32)
            kept.insert(points, number)
            for point in points:
                cell = tuple(np.floor(point / np.float32(0.25)).astype(int))
                last[cell] = tuple(point)
        found = {tuple(np.floor(p / np.float32(0.25)).astype(int)): tuple(p) for p in kept.points}
        assert found == last
        assert len(kept.points) == len(last)

    def test_resolves_points_far_from_the_origin(self) -> None:
        kept = VoxelMap(0.1)
        places = np.array([[9e4, -9e4, 5.0], [9e4 + 0.5, -9e4, 5.0], [-9e4, 9e4, 5.0]])
        kept.insert(places.astype(np.float32), 1)
        assert len(kept.points) == 3


class TestMarkers:
    @pytest.mark.parametrize(
        ("kind", "scale", "nearest"),
        [
            (CUBE, [0.4, 0.6, 2.0], 2.8),
            (CYLINDER, [0.6, 0.6, 2.0], 2.7),
            (SPHERE, [1.0, 1.0, 1.0], 2.5),
        ],
    )
    def test_marker_has_its_pose_and_size(
        self, kind: int, scale: list[float], nearest: float
    ) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_markers([marker(kind=kind, scale=np.array(scale))])
        away = np.linalg.norm(known(w, SECOND) - [0.0, 0.0, 1.0], axis=1)
        assert away.min() == pytest.approx(nearest, abs=0.01)

    def test_add_replaces_delete_removes_and_deleteall_clears(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_markers([marker(1), marker(2, p=np.array([-3.0, 0, 1]))])
        assert known(w, SECOND)[:, 0].min() < -2.0
        w.receive_markers([marker(2, action=DELETE)])
        assert known(w, SECOND)[:, 0].min() > 2.0
        w.receive_markers([marker(action=DELETEALL), marker(3, p=np.array([0, 5.0, 1]))])
        assert np.abs(known(w, SECOND)[:, 0]).max() < 1.0

    def test_a_lifetime_ends(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_markers([marker(lifetime_ns=SECOND)])
        assert len(known(w, SECOND + 9 * 10**8))
        assert not len(known(w, 2 * SECOND + 1))

    def test_moved_marker_is_predicted_for_a_second(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_markers([marker(stamp_ns=SECOND, p=np.array([3.0, 0.0, 1.0]))])
        later = SECOND + 10**8
        w.receive_odometry(at(later))
        w.receive_markers([marker(stamp_ns=later, p=np.array([3.0, 0.2, 1.0]))])
        assert not len(known(w, later))  # it does not stand any more
        moving = w.moving(later + 5 * 10**8, near=HERE, radius=10.0)
        assert moving.v_W == pytest.approx(np.tile([0.0, 2.0, 0.0], (len(moving.v_W), 1)))
        assert moving.p_W.mean(axis=0) == pytest.approx(np.array([3.0, 1.2, 1.0]), abs=0.02)
        assert len(set(moving.body.tolist())) == 1 and (moving.age == 0.0).all()
        stopped = w.moving(later + 5 * SECOND, near=HERE, radius=10.0)
        assert stopped.p_W[:, 1].mean() == pytest.approx(2.2, abs=0.02)

    def test_marker_at_rest_is_static_again(self) -> None:
        w = world()
        for number, y in enumerate((0.0, 0.2, 0.2)):
            stamp_ns = SECOND + number * 10**8
            w.receive_odometry(at(stamp_ns))
            w.receive_markers([marker(stamp_ns=stamp_ns, p=np.array([3.0, y, 1.0]))])
        assert len(known(w, stamp_ns)) and not len(w.moving(stamp_ns, near=HERE, radius=9.0).p_W)

    def test_repeated_message_keeps_the_marker_speed(self) -> None:
        w = world()
        for stamp_ns, y in ((SECOND, 0.0), (SECOND + 10**8, 0.2), (SECOND + 10**8, 0.2)):
            w.receive_odometry(at(stamp_ns))
            w.receive_markers([marker(stamp_ns=stamp_ns, p=np.array([3.0, y, 1.0]))])
        assert w.moving(SECOND + 10**8, near=HERE, radius=9.0).v_W[0, 1] == pytest.approx(2.0)

    def test_jumped_marker_counts_as_a_new_static_object(self) -> None:
        w = world()
        for stamp_ns, y in ((SECOND, 0.0), (SECOND + 10**8, 8.0)):
            w.receive_odometry(at(stamp_ns))
            w.receive_markers([marker(stamp_ns=stamp_ns, p=np.array([3.0, y, 1.0]))])
        assert known(w, SECOND + 10**8)[:, 1].min() > 7.0

    def test_repeated_static_markers_have_no_effect(self) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        w.receive_markers([marker()])
        revision = w.revision
        w.receive_markers([marker(stamp_ns=SECOND + 10**8)])
        assert w.revision == revision

    @pytest.mark.parametrize(
        ("fields", "reason"),
        [
            ({"kind": 9}, "'things' 1 of type 9, expected one of CUBE"),
            ({"action": 7}, "with the action 7"),
            ({"p": np.array([math.nan, 0, 0])}, "numbers that are not finite"),
            ({"scale": np.array([1.0, 0.0, 1.0])}, r"scale \[1.0, 0.0, 1.0\]"),
            ({"q_xyzw": np.zeros(4)}, "not a unit quaternion"),
            ({"scale": np.array([1e3, 1e3, 0.1])}, "with a surface of 2000400 m.2, expected 4000"),
            ({"frame_id": "moon"}, "frame 'moon'"),
        ],
    )
    def test_unusable_marker_is_rejected_and_others_are_used(
        self, fields: dict[str, Any], reason: str
    ) -> None:
        w = world()
        w.receive_odometry(at(SECOND))
        with pytest.raises(ValueError, match=reason):
            w.receive_markers([marker(1, **fields), marker(2)])
        assert len(known(w, SECOND))


class TestNeighbours:
    def plan(self, stamp_ns: int, p: Any, step: float = 0.1, frame_id: str = "odom") -> TimedPath:
        positions = np.array(p, dtype=float)
        times = stamp_ns + np.arange(len(positions), dtype=np.int64) * round(step * SECOND)
        return TimedPath(stamp_ns=stamp_ns, frame_id=frame_id, times_ns=times, p=positions)

    def test_neighbour_follows_its_plan(self) -> None:
        w = world(neighbours=("uav2",))
        w.receive_odometry(at(SECOND))
        w.receive_neighbour("uav2", self.plan(SECOND, [[3, 0, 1], [3, 1, 1], [2, 1, 1]]))
        # Before, between and beyond.
        found = w.plans([SECOND - 10**8, SECOND + 15 * 10**7, SECOND + 3 * 10**8])
        expected = [[3.0, -1.0, 1.0], [2.5, 1.0, 1.0], [1.0, 1.0, 1.0]]
        assert found.p_W == pytest.approx(np.array([expected])) and found.age.tolist() == [0.0]

    def test_outdated_plan_is_replaced_by_the_odometry(self) -> None:
        w = world(neighbours=("uav2",))
        w.receive_neighbour("uav2", self.plan(SECOND, [[3, 0, 1], [3, 0.1, 1]]))
        now = SECOND + 8 * 10**8
        w.receive_odometry(at(now))
        w.receive_neighbour("uav2", at(now, (3.0, 5.0, 1.0)))
        found = w.plans([now])
        assert found.p_W[0, 0].tolist() == pytest.approx([3.0, 0.8, 1.0])
        assert found.age[0] == pytest.approx(0.8)
        now = 3 * SECOND
        w.receive_odometry(at(now))
        w.receive_neighbour("uav2", at(now, (3.0, 5.0, 1.0)))
        found = w.plans([now + 10**8])
        assert found.p_W[0, 0].tolist() == [3.0, 5.0, 1.0] and found.age[0] == 0.0

    def test_silent_neighbour_is_removed(self) -> None:
        w = world(neighbours=("uav2",))
        w.receive_neighbour("uav2", at(SECOND, (3.0, 5.0, 1.0)))
        w.receive_odometry(at(3 * SECOND))
        assert len(w.plans([3 * SECOND]).p_W) == 1
        w.receive_odometry(at(5 * SECOND))
        assert len(w.plans([5 * SECOND]).p_W) == 0

    @pytest.mark.parametrize(
        ("plan", "reason"),
        [
            (
                TimedPath(
                    stamp_ns=1, frame_id="odom", times_ns=np.zeros(1, np.int64), p=np.zeros((1, 3))
                ),
                "a plan of 1 positions",
            ),
            (
                TimedPath(
                    stamp_ns=1, frame_id="odom", times_ns=np.zeros(2, np.int64), p=np.zeros((2, 3))
                ),
                "stamps do not increase",
            ),
            (
                TimedPath(stamp_ns=1, frame_id="map", times_ns=np.arange(2), p=np.zeros((2, 3))),
                "in 'map', expected 'odom'",
            ),
            (at(SECOND, (math.nan, 0, 0)), "not finite"),
        ],
    )
    def test_refuses_an_invalid_plan_by_name(self, plan: Any, reason: str) -> None:
        w = world(neighbours=("uav2",))
        with pytest.raises(ValueError, match=f"neighbour 'uav2': .*{reason}"):
            w.receive_neighbour("uav2", plan)
        assert not len(w.plans([SECOND]).p_W)


def sound_markers() -> bytes:
    message = new_message("visualization_msgs/msg/MarkerArray")
    for number, kind in enumerate((CUBE, SPHERE, CYLINDER)):
        each = marker(number, kind=kind)
        message.markers.append(filled_marker(each, new=new_message))
    return encoded(message)


@pytest.mark.parametrize("seed", range(4))
def test_malformed_bytes_never_crash(seed: int) -> None:
    """Two thousand clouds and arrays of markers with bytes changed, cut and put in."""
    random = np.random.default_rng(seed)
    w = world()
    w.receive_odometry(at(SECOND))
    points = random.normal(size=(20, 3)).astype(np.float32)
    sound = written_point_cloud(cloud(points, SECOND))
    refused = 0
    for number in range(500):
        kind = number % 2
        data = bytearray((sound, sound_markers())[kind])
        for _ in range(int(random.integers(1, 6))):
            place = int(random.integers(len(data)))
            match int(random.integers(4)):
                case 0:
                    data[place] = int(random.integers(256))
                case 1:
                    data[place : place + 4] = b"\xff\xff\xff\xff"
                case 2:
                    del data[place:]
                case _:
                    data[place:place] = random.bytes(3)
            if not data:
                break
        try:
            if kind:
                w.receive_markers(markers_from_message(message_in(OBSTACLE_MARKERS, bytes(data))))
            else:
                w.receive_cloud(point_cloud_from_message(message_in(OBSTACLES, bytes(data))))
        except ValueError as error:
            refused += 1
            assert "\n" not in str(error)
        found = known(w, SECOND)
        assert np.isfinite(found).all()
        assert np.isfinite(w.moving(SECOND, near=HERE, radius=9.0).p_W).all()
    assert 100 < refused < 500


Do = Callable[[ObstacleWorld, LocalMapProvider], object]
AFTER_RESET = np.array([5.0, 0.0, 1.0])


def between(
    call: Do, other: Do, before: Do = lambda w, around: None
) -> Iterator[tuple[ObstacleWorld, LocalMapProvider]]:
    """Yield worlds and maps in which a call was interrupted by another, at each bytecode."""
    made: list[tuple[ObstacleWorld, LocalMapProvider]] = []

    def prepare() -> tuple[Callable[[], object], Callable[[], object]]:
        w = world()
        around = LocalMapProvider(w)
        around.wake = lambda: None
        w.receive_odometry(at(SECOND))
        before(w, around)
        around.at(HERE, SECOND, radius=6.0, far=1.0)
        made.append((w, around))
        return lambda: call(w, around), lambda: other(w, around)

    modules = world_module, clouds, frames, local_map, markers
    for _ in interleaved(prepare, *modules, waits=lambda: made[-1][0]._lock.locked()):
        yield made[-1]


def reset(w: ObstacleWorld, around: LocalMapProvider) -> None:
    step_W = AFTER_RESET - at(SECOND).p_WB
    w.reset_estimate(EstimateReset(stamp_ns=0, turn=0.0, step_W=step_W))
    around.forget()
    w.receive_odometry(at(SECOND, AFTER_RESET))


def scan(w: ObstacleWorld, around: LocalMapProvider) -> None:
    with contextlib.suppress(ValueError):  # no odometry since the reset
        w.receive_cloud(cloud([[2, 0, 0]], SECOND, "base_link"))


def give_map(w: ObstacleWorld, around: LocalMapProvider) -> None:
    w.receive_cloud(cloud([[1, 2, 3]], SECOND))


class TestThreads:
    """Clouds are read, and maps made, in another thread than ticks and all else."""

    def test_map_published_once_is_kept(self) -> None:
        for w, _ in between(lambda w, _: w.points(SECOND, near=HERE, radius=20.0), give_map):
            assert len(w.points(SECOND, near=HERE, radius=9.0)) == 1

    @pytest.mark.parametrize("calls", [(reset, scan), (scan, reset)])
    def test_no_point_is_in_the_coordinates_before_a_reset(self, calls: tuple[Do, Do]) -> None:
        for w, _ in between(*calls):
            points = w.points(SECOND, near=HERE, radius=20.0)
            assert points.tolist() in ([], [[7.0, 0.0, 1.0]])

    def test_no_local_map_is_in_the_coordinates_before_a_reset(self) -> None:
        def update_map(w: ObstacleWorld, around: LocalMapProvider) -> None:
            give_map(w, around)
            around.update_map()

        for _, around in between(update_map, reset, before=scan):
            assert len(around.at(HERE, SECOND, radius=6.0, far=1.0).points) < 2
