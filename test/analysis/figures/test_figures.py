# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a flight: panels, images, obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpl_toolkits.mplot3d import art3d

from quad_mpc_ros.analysis.figures import space, style, write_figures
from quad_mpc_ros.analysis.figures.panels import (
    attitude_panels,
    clearance_panels,
    error_panels,
    input_panels,
    position_panels,
    velocity_panels,
)
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.simulation.shapes import Cylinder, Scene

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


def test_no_line_is_drawn_where_odometry_is_missing(
    circling: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = circling.stamp_ns + np.where(np.arange(300) < 150, 0, 6_400_000_000)
    flight = replace(circling, stamp_ns=later, publish_time_ns=later)
    ((begin, end),) = flight.gaps
    assert end - begin == pytest.approx(6.42)
    for panel in [*position_panels(flight), *velocity_panels(flight), *error_panels(flight)]:
        for curve in panel.curves:
            (place,) = np.flatnonzero(np.isnan(curve.values))
            assert curve.time[place - 1] <= begin < curve.time[place] < end
            assert curve.time[place + 1] >= end

    figures: dict[str, Figure] = {}
    monkeypatch.setattr(
        style, "save", lambda figure, path, **_: figures.update({path.stem: figure})
    )
    write_figures(flight, tmp_path)
    path = figures.pop("path").axes[0]
    for axes in (axes for figure in figures.values() for axes in figure.axes):
        (shade,) = (each for each in axes.collections if each.get_label() == "no odometry")
        (span,) = (each.get_extents() for each in shade.get_paths())
        assert (span.x0, span.x1) == pytest.approx((begin, end))
    last, first = flight.p_WB[149], flight.p_WB[150]
    for line in path.lines[-2:]:  # of the reference and of the flight on the ground
        assert np.isnan(line.get_data_3d()[0]).sum() == 1
    (flown,) = (each for each in path.collections if each.get_array() is not None)
    pieces = np.array(flown._segments3d)
    assert len(pieces) == 298
    assert last in pieces[:, 1] and first in pieces[:, 0]
    assert not np.any(np.all(pieces == np.stack((last, first)), axis=(1, 2)))


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


def test_figure_of_a_flat_flight_has_no_white_bands(circling: Flight, tmp_path: Path) -> None:
    flat = replace(circling, p_WB=circling.p_WB * np.array([10.0, 10.0, 1.0]))
    write_figures(flat, tmp_path)
    rows = np.flatnonzero((imread(tmp_path / "path.png")[..., :3] < 1.0).any(axis=(1, 2)))
    height = len(imread(tmp_path / "path.png"))
    assert rows[0] < 0.03 * height
    assert rows[-1] > 0.97 * height
    assert np.diff(rows).max() < 0.1 * height


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
    assert panel.curves[-1].values == pytest.approx(0.7 - among.mpc.radius, abs=1e-3)
    assert clearance_panels(circling) == []


class TestAttitude:
    def test_the_recorded_sign_is_kept_and_continued(self, circling: Flight) -> None:
        """Once round, the same attitude is reached as the negative of the quaternion."""
        w, *_, z = attitude_panels(circling)
        turned = np.linspace(0.0, np.pi, 300)
        assert w.curves[-1].values == pytest.approx(np.cos(turned))
        assert z.curves[-1].values == pytest.approx(np.sin(turned))
        assert np.all(w.curves[0].values == 1.0)

    def test_continues_the_sign_of_a_source_with_positive_w(
        self, make_flight: FlightMaker, circling: Flight
    ) -> None:
        q = circling.q_WB_xyzw * np.where(circling.q_WB_xyzw[:, 3:] < 0.0, -1.0, 1.0)
        assert np.abs(np.diff(q, axis=0)).max() > 1.9  # the jump that is no motion
        panels = attitude_panels(make_flight(300, q_WB_xyzw=q))
        flown = [panel.curves[-1].values for panel in panels]
        assert max(np.abs(np.diff(values)).max() for values in flown) < 0.02
        assert flown[0][-1] == pytest.approx(-1.0)


def test_inputs_are_held_within_the_bounds_of_the_controller(circling: Flight) -> None:
    panels = input_panels(circling)
    assert all(panel.curves[-1].held for panel in panels)
    assert [panel.bounds for panel in panels] == [
        (0.0, 1.0),
        *((-limit * np.pi, limit * np.pi) for limit in (6.0, 6.0, 3.0)),
    ]
    assert panels[3].curves[-1].values.tolist() == [2.0] * 300
    assert not any(panel.curves[-1].held for panel in velocity_panels(circling))


def test_draws_vehicles_evenly_along_a_path(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = np.linspace(0.0, 20.0 * np.pi, 4000)
    circles = np.column_stack((np.cos(turns), np.sin(turns), np.ones(4000)))
    level = np.tile([0.0, 0.0, 0.0, 1.0], (4000, 1))
    axes = space.draw_room(style.new_figure(8.0, 6.0, dpi=60), -np.ones(3), np.ones(3))
    beams: list[np.ndarray] = []
    monkeypatch.setattr(art3d, "Line3DCollection", lambda given, **_: beams.extend(given))
    monkeypatch.setattr(axes, "add_collection", lambda _: None)
    space.draw_vehicles(axes, circles, level, side=2.4, zorder=1)
    centres = np.array(beams).reshape(-1, 2, 2, 3).mean(axis=(1, 2))
    assert len(centres) in (14, 15)  # the last one may be rounded away
    assert centres[0] == pytest.approx(circles[0])
    assert np.linalg.norm(centres[:, :2], axis=1) == pytest.approx(1.0)
