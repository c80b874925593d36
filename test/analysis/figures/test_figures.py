"""The pictures: what is drawn, and that something is to be seen on them."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.image import imread

from quad_mpc_ros.analysis.figures import obstacles, space, style, write_figures
from quad_mpc_ros.analysis.figures.panels import (
    Curve,
    attitude_panels,
    clearance_panels,
    error_panels,
    input_panels,
    position_panels,
    velocity_panels,
)
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.simulation.scene import Scene
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Shape, Sphere

FlightMaker = Callable[..., Flight]


@pytest.fixture
def circling(make_flight: FlightMaker, build: SimpleNamespace) -> Flight:
    """Return a flight round a circle that chases three waypoints, turning with it."""
    count = 300
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    p_WB = np.column_stack((np.cos(angle), np.sin(angle), 1.0 + 0.1 * angle))
    corners = np.repeat([[1.0, 0.0, 1.0], [-0.5, 0.9, 1.3], [-0.5, -0.9, 1.5]], 100, axis=0)
    zeros = np.zeros(count)
    stamp_ns = build.start_ns + build.period_ns * np.arange(count)
    rates = np.column_stack((10 * np.sin(3 * angle), 8 * np.cos(angle), np.full(count, 2.0)))
    return make_flight(
        count,
        p_WB=p_WB,
        q_WB_xyzw=np.column_stack((zeros, zeros, np.sin(angle / 2), np.cos(angle / 2))),
        v_WB_B=np.column_stack((1.0 + 0.5 * np.sin(angle), zeros, zeros)),
        reference=build.reference(corners),
        commands=build.commands(stamp_ns, w_WB_B=rates),
    )


def test_no_line_is_drawn_where_odometry_is_missing(circling: Flight, tmp_path: Path) -> None:
    later = circling.stamp_ns + np.where(np.arange(300) < 150, 0, 6_400_000_000)
    flight = replace(circling, stamp_ns=later, publish_time_ns=later)
    ((begin, end),) = flight.gaps
    assert end - begin == pytest.approx(6.42)
    for panel in [*position_panels(flight), *velocity_panels(flight), *error_panels(flight)]:
        for curve in panel.curves:
            for drawn in (curve, curve.thinned(40)):
                (place,) = np.flatnonzero(np.isnan(drawn.values))
                assert drawn.time[place - 1] <= begin < drawn.time[place] < end
                assert drawn.time[place + 1] >= end
    for path in write_figures(flight, tmp_path):
        assert fraction_of(path, "#FFFFFF") > 0.2


def fraction_of(path: Path, colour: str) -> float:
    """Return the part of a picture's pixels that is of a colour, but for rounding."""
    pixels = imread(path)[..., :3]
    return float(np.mean(np.all(np.abs(pixels - style.rgb(colour)) < 0.02, axis=-1)))


def test_five_figures_are_not_empty(circling: Flight, tmp_path: Path) -> None:
    paths = write_figures(circling, tmp_path / "deep" / "figures")
    names = ["position", "attitude", "velocity", "inputs", "path"]
    assert [path.name for path in paths] == [f"{name}.png" for name in names]
    for path in paths:
        height, width, _ = imread(path).shape
        assert min(height, width) >= 1000
        assert fraction_of(path, "#FFFFFF") > 0.4
        assert fraction_of(path, style.REFERENCE) > 5e-4, path
    for path in paths[:4]:
        assert fraction_of(path, style.FLOWN) > 1e-3, path
    assert fraction_of(paths[3], style.BOUND) > 5e-4
    assert fraction_of(paths[4], style.BOUND) > 1e-4  # waypoints


def test_draws_flights_with_missing_data(
    make_flight: FlightMaker, build: SimpleNamespace, tmp_path: Path
) -> None:
    none = np.zeros(0, dtype=np.int64)
    bare = make_flight(1, reference=None, commands=build.commands(none), stats=build.stats([]))
    paths = write_figures(bare, tmp_path / "bare")
    assert [path.stem for path in paths] == ["position", "attitude", "velocity", "path"]
    assert all(path.stat().st_size > 5000 for path in paths)
    assert len(write_figures(make_flight(2), tmp_path / "hover")) == 5


def test_obstacles_are_drawn_with_the_distance_to_them(circling: Flight, tmp_path: Path) -> None:
    pillar = Cylinder(p_WO=np.array([0.0, 0.0, 1.0]), radius=0.3, height=2.0)
    among = replace(circling, scene=Scene([pillar]))
    paths = write_figures(among, tmp_path)
    assert [path.stem for path in paths][-2:] == ["clearance", "path"]
    plain = write_figures(circling, tmp_path / "plain")[-1]
    assert not np.array_equal(imread(paths[-1]), imread(plain))
    assert fraction_of(paths[-2], style.FLOWN) > 1e-3
    # On a circle of 1 m about the pillar, 0.7 m from its surface.
    (panel, *_) = clearance_panels(among)
    assert panel.curve("flown").values == pytest.approx(0.7 - among.mpc.radius, abs=1e-3)
    assert clearance_panels(circling) == []


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Box(p_WO=np.ones(3), size=np.array([0.5, 2.0, 3.0])), 3.0),
        (Cylinder(p_WO=np.ones(3), radius=0.5, height=2.0), 0.5 * math.pi),
        (Sphere(p_WO=np.ones(3), radius=1.0), 4.0 / 3.0 * math.pi),
    ],
)
def test_faces_of_an_obstacle_enclose_its_volume(shape: Shape, volume: float) -> None:
    """By the divergence theorem over triangles that look outwards; round ones are polygons."""
    faces = obstacles.faces(shape)
    triangles = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    a, b, c = np.moveaxis(np.array(triangles) - shape.p_WO, 1, 0)
    enclosed = np.abs(np.einsum("ni,ni->n", a, np.cross(b, c))).sum() / 6.0
    assert 0.85 * volume < enclosed <= volume + 1e-9
    assert np.abs(shape.distance(np.vstack(faces))).max() < 1e-9


class TestAttitude:
    def test_the_recorded_sign_is_kept_and_continued(self, circling: Flight) -> None:
        """Once round, the same attitude is reached as the negative of the quaternion."""
        w, *_, z = attitude_panels(circling)
        turned = np.linspace(0.0, np.pi, 300)
        assert w.curve("flown").values == pytest.approx(np.cos(turned))
        assert z.curve("flown").values == pytest.approx(np.sin(turned))
        assert np.all(w.curve("reference").values == 1.0)

    def test_continues_the_sign_of_a_source_with_positive_w(
        self, make_flight: FlightMaker, circling: Flight
    ) -> None:
        q = circling.q_WB_xyzw * np.where(circling.q_WB_xyzw[:, 3:] < 0.0, -1.0, 1.0)
        assert np.abs(np.diff(q, axis=0)).max() > 1.9  # the jump that is no motion
        panels = attitude_panels(make_flight(300, q_WB_xyzw=q))
        flown = [panel.curve("flown").values for panel in panels]
        assert max(np.abs(np.diff(values)).max() for values in flown) < 0.02
        assert flown[0][-1] == pytest.approx(-1.0)

    def test_a_flight_may_begin_with_either_sign(self, make_flight: FlightMaker) -> None:
        q = np.tile([0.0, 0.0, 0.0, -1.0], (5, 1))
        w = attitude_panels(make_flight(5, q_WB_xyzw=q))[0]
        assert w.curve("flown").values.tolist() == [-1.0] * 5


def test_inputs_are_held_within_the_bounds_of_the_controller(circling: Flight) -> None:
    panels = input_panels(circling)
    assert all(panel.curve("commanded").held for panel in panels)
    assert [panel.bounds for panel in panels] == [
        (0.0, 1.0),
        *((-limit * np.pi, limit * np.pi) for limit in (6.0, 6.0, 3.0)),
    ]
    assert panels[3].curve("commanded").values.tolist() == [2.0] * 300
    assert not any(panel.curve("flown").held for panel in velocity_panels(circling))


def test_peaks_of_a_long_curve_are_drawn() -> None:
    values = np.sin(np.arange(100_001) / 1000.0)
    values[70_123], values[30_456] = 5.0, -7.0
    values[50_000:50_010] = np.nan
    hover = np.arange(100_001).astype(str)
    whole = Curve(name="long", time=np.arange(100_001.0), values=values, hover=hover)
    thin = whole.thinned(1000)
    assert thin.hover is not None
    assert 500 < len(thin.time) <= 1003
    assert np.all(np.diff(thin.time) > 0.0)
    assert (thin.time[0], thin.time[-1]) == (0.0, 100_000.0)
    assert (np.nanmax(thin.values), np.nanmin(thin.values)) == (5.0, -7.0)
    assert thin.hover.tolist() == [str(int(time)) for time in thin.time]
    assert whole.thinned(100_001) is whole


def test_grid_of_3d_figures_is_as_light_as_of_others(tmp_path: Path) -> None:
    """It takes its colour where mplot3d lets one give it, which is in no argument."""
    figure = style.new_figure(4.0, 4.0, dpi=100)
    axes = space.draw_room(figure, np.zeros(3), np.ones(3))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.line.set_color("white")
        axis.set_tick_params(labelcolor="white", color="white")
        axis.set_label_text("")
    pixels = imread(style.save(figure, tmp_path / "room.png"))[..., :3]
    assert np.mean(np.all(np.abs(pixels - style.rgb(style.GRID)) < 0.02, axis=-1)) > 5e-3
    assert pixels.min() > 0.85  # matplotlib's own grid is darker


def test_matplotlib_is_imported_only_to_draw_and_pyplot_never(tmp_path: Path) -> None:
    program = f"""
import sys
import numpy as np
from quad_mpc_ros.analysis import figures
from quad_mpc_ros.recordings.flight import CommandTrack, Flight
assert "matplotlib" not in sys.modules
from quad_mpc_ros.control.config import MpcConfig
stamp_ns, zeros = np.arange(5) * 10**7, np.zeros((5, 3))
flight = Flight(
    stamp_ns=stamp_ns, publish_time_ns=stamp_ns, p_WB=zeros, v_WB_B=zeros, w_WB_B=zeros,
    q_WB_xyzw=np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)), reference=None, stats={{}}, parameters={{}},
    commands=CommandTrack(
        stamp_ns=stamp_ns, publish_time_ns=stamp_ns, throttle=zeros[:, 0], w_WB_B=zeros
    ),
    mpc=MpcConfig(),
)
from pathlib import Path
figures.write_figures(flight, Path({str(tmp_path)!r}))
assert "matplotlib" in sys.modules
assert "matplotlib.pyplot" not in sys.modules
assert not [name for name in sys.modules if name.split(".")[0] in ("rclpy", "nav_msgs")]
"""
    finished = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
