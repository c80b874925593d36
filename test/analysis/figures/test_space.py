"""Figures in space: nothing is cut, and no vehicle hides another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from mpl_toolkits.mplot3d import art3d

from quad_mpc_ros.analysis.figures import space, style

ROOMS = {
    "a hover": (1.0, 1.0, 2.2),
    "a square": (2.4, 2.4, 2.4),
    "a lemniscate": (7.0, 3.5, 3.0),
    "a vertical loop": (3.6, 1.6, 5.5),
    "a dash": (60.0, 3.0, 4.0),
    "a climb": (1.0, 1.0, 40.0),
}


@pytest.mark.parametrize("size", ROOMS.values(), ids=ROOMS)
def test_a_picture_is_cropped_to_the_room_and_its_labels(
    size: tuple[float, ...], tmp_path: Path
) -> None:
    figure = style.new_figure(8.0, 8.0, dpi=60)
    axes = space.draw_room(figure, np.zeros(3), np.array(size))
    box = space.drawn_box(figure, axes).transformed(figure.dpi_scale_trans.inverted())
    picture = imread(style.save(figure, tmp_path / "room.png", crop=box.padded(0.1)))[:, :, 0]
    rows, columns = (np.flatnonzero((picture < 1.0).any(axis=axis)) for axis in (1, 0))
    for drawn, count in ((rows, picture.shape[0]), (columns, picture.shape[1])):
        assert 0 < drawn[0] < 15  # pixels
        assert 0 < count - 1 - drawn[-1] < 15


def test_vehicles_on_a_place_that_is_passed_again_are_drawn_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    turns = np.linspace(0.0, 20.0 * np.pi, 4000)
    circles = np.column_stack((np.cos(turns), np.sin(turns), np.ones(4000)))
    figure = style.new_figure(8.0, 6.2, dpi=60)
    axes = space.draw_room(figure, np.array([-1.2, -1.2, 0.0]), np.array([1.2, 1.2, 1.2]))
    beams: list[np.ndarray] = []
    monkeypatch.setattr(art3d, "Line3DCollection", lambda given, **_: beams.extend(given))
    monkeypatch.setattr(axes, "add_collection", lambda _: None)
    space.draw_vehicles(
        axes,
        circles,
        np.tile([0.0, 0.0, 0.0, 1.0], (4000, 1)),
        way=space.way_along(circles),
        spacing=0.5,
        side=2.4,
        zorder=1,
        apart=True,
    )
    starts = np.array([beam[0] for beam in beams])[::2]
    between = np.linalg.norm(starts[:, None] - starts, axis=2)
    # Of ten circles 125 places are due; on one there is room for some ten.
    assert 6 <= len(starts) <= 16
    assert between[between > 0.0].min() > 0.3
