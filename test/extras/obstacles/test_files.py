# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files of obstacles: what they state, and what is wrong with them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from quad_mpc_ros.cli import main
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.extras.obstacles.files import read_scene
from quad_mpc_ros.simulation.shapes import Box, Cylinder, Sphere

GOOD = """
obstacles:
  - {shape: box, position: [4, 0.0, 1.5], size: [0.4, 0.6, 3.0], yaw: 1.5707963}
  - {shape: cylinder, position: [6.0, 1.0, 1.0], radius: 2e-1, height: 2.0}
  - shape: sphere
    position: [8.0, 0.0, 2.0]
    radius: 0.5
    velocity: [0.0, 1.0, 0.0]
    appears_at: 2.5
volume: {minimum: [-1.0, -5.0, 0.0], maximum: [12.0, 5.0, 4.0]}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "obstacles.yaml"
    path.write_text(text)
    return path


def test_reads_shapes_and_volume(tmp_path: Path) -> None:
    scene = read_scene(written(tmp_path, GOOD))
    box, cylinder, sphere = scene.shapes
    assert isinstance(box, Box) and box.size.tolist() == [0.4, 0.6, 3.0]
    assert math.atan2(box.R_WO[1, 0], box.R_WO[0, 0]) == pytest.approx(1.5707963)
    assert isinstance(cylinder, Cylinder) and (cylinder.radius, cylinder.height) == (0.2, 2.0)
    assert isinstance(sphere, Sphere) and sphere.v_WO_W.tolist() == [0.0, 1.0, 0.0]
    assert sphere.appears_at == 2.5 and sphere.p_WO.tolist() == [8.0, 0.0, 2.0]
    assert scene.volume is not None and scene.volume.maximum.tolist() == [12.0, 5.0, 4.0]


def entry(fields: str) -> str:
    return f"obstacles:\n  - {{shape: sphere, position: [0, 0, 1], radius: 1}}\n  - {{{fields}}}\n"


BAD = {
    "no mapping": ("- 1", "expected 'obstacles:' with a list"),
    "no list": ("obstacles: 3", "obstacles: given 3, expected a list"),
    "misspelt section": (
        "obstacle: []",
        "obstacle: unknown (did you mean obstacles?)",
    ),
    "no entry": ("obstacles: [3]", "obstacles[1]: given 3, expected {shape: box"),
    "no shape": (entry("position: [0, 0, 1]"), "obstacles[2].shape: given None, expected one of"),
    "another shape": (entry("shape: bax"), "obstacles[2].shape: given 'bax', expected one of box"),
    "no position": (entry("shape: box, size: [1, 1, 1]"), "[2].position: given None, expected 3"),
    "not a number": (
        entry("shape: box, position: [1, 2, nan], size: [1, 1, 1]"),
        "obstacles[2].position: given [1, 2, nan], expected 3 numbers",
    ),
    "flat box": (
        entry("shape: box, position: [1, 2, 3], size: [1, 0, 1]"),
        "obstacles[2].size: given [1, 0, 1], expected 3 numbers > 0",
    ),
    "no radius": (
        entry("shape: cylinder, position: [1, 2, 3], height: 2"),
        "obstacles[2].radius: given None, expected a number > 0",
    ),
    "size of a sphere": (
        entry("shape: sphere, position: [1, 2, 3], radius: 1, size: [1, 1, 1]"),
        "obstacles[2].size: unknown, expected shape, position",
    ),
    "misspelt field": (
        entry("shape: sphere, positon: [1, 2, 3], radius: 1"),
        "obstacles[2].positon: unknown (did you mean position?), expected shape",
    ),
    "early": (
        entry("shape: sphere, position: [1, 2, 3], radius: 1, appears_at: -1"),
        "obstacles[2].appears_at: given -1, expected a number >= 0",
    ),
    "volume": (
        "volume: {minimum: [0, 0, 0], maximum: [1, 1, 0]}",
        "volume.minimum: given [0, 0, 0], expected 3 numbers below maximum [1, 1, 0]",
    ),
    "ground": (
        entry("shape: box, position: [0, 0, 0], size: [500, 500, 1]"),
        "given surfaces of 502013 m^2 in all, expected 20000 m^2 at most",
    ),
    "no YAML": ("obstacles: [", "not YAML"),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD.keys())
def test_reports_errors_in_one_line(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UserError) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert message in str(caught.value)


def test_the_command_line_refuses_a_bad_file_with_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, BAD["flat box"][0])
    assert main(["simulate", "--obstacles", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "obstacles[2].size" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_sensor_needs_obstacles(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--sensor", "rays"]) == 2
    assert "needs --obstacles FILE" in capsys.readouterr().err
