# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""References from tables and recordings: reading, smoothing, and errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quad_mpc_ros.configuration import ConfigurationError, UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.point_table import PointTable, read_csv, table_path

HEADER = "time [s], x [m], y [m], z [m]"
ROWS = [f"{0.5 * k}, {0.1 * k * k}, {k}, 2" for k in range(8)]


def written(folder: Path, *lines: str) -> Path:
    file = folder / "table.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_reads_table(tmp_path: Path) -> None:
    found = read_csv(written(tmp_path, "# recorded on Monday", HEADER, *ROWS[:3], "", *ROWS[3:]))
    assert_allclose(found.seconds, 0.5 * np.arange(8))
    assert_allclose(found.p_WB[:, 0], 0.1 * np.arange(8) ** 2)
    assert_allclose(found.p_WB[:, 1:], [[k, 2.0] for k in range(8)])
    assert found.yaw is None


def test_columns_may_come_in_any_order_with_yaw(tmp_path: Path) -> None:
    rows = [f"{k},0,1,{0.2 * k},{3 * k}" for k in range(6)]
    found = read_csv(written(tmp_path, "time [s],x [m],z [m],yaw [rad],y [m]", *rows))
    assert found.yaw is not None
    assert_allclose(found.yaw, 0.2 * np.arange(6))
    assert_allclose(found.p_WB[2], [0.0, 6.0, 1.0])


MISTAKES = {
    "empty": ([], "empty, expected a header time [s], x [m]"),
    "no header": (ROWS, "line 1: column '0.0', expected time [s]"),
    "column missing": (["time [s], x [m], y [m]", *ROWS], "line 1: no column z"),
    "unknown column": ([f"{HEADER}, vt [m/s]", *ROWS], "line 1: column 'vt [m/s]', expected"),
    "part of a motion": ([f"{HEADER}, vx [m/s]", *ROWS], "line 1: no column vy, vz, ax"),
    "column twice": ([f"{HEADER}, x [m]", *ROWS], "line 1: column 'x [m]', expected"),
    "wrong unit": (
        ["time [s], x [ft], y [m], z [m]", *ROWS],
        "line 1: column 'x [ft]', expected time [s], x [m]",
    ),
    "no unit": (["time, x [m], y [m], z [m]", *ROWS], "column 'time', expected time [s]"),
    "value missing": ([HEADER, *ROWS, "9, 1, 1"], "line 10: 3 values, expected 4"),
    "text": ([HEADER, *ROWS, "9, high, 1, 1"], "line 10: x is 'high', expected a finite"),
    "nan": ([HEADER, *ROWS, "9, 1, nan, 1"], "line 10: y is 'nan', expected a finite number"),
    "infinite": ([HEADER, *ROWS, "9, 1, 1, inf"], "line 10: z is 'inf'"),
    "time backwards": ([HEADER, *ROWS, "1, 1, 1, 1"], "line 10: time 1 s is not after 3.5 s"),
    "time twice": ([HEADER, *ROWS, "3.5, 1, 1, 1"], "line 10: time 3.5 s is not after 3.5 s"),
    "semicolons": ([HEADER.replace(",", ";"), *ROWS], "expected time [s], x [m], y [m], z [m]"),
    "decimal commas": ([HEADER, "0,0,1,0,0,5,2,0"], "8 values, expected 4 (time, x, y, z); write"),
    "quoted decimal commas": (
        [HEADER, '"0,5",1,1,1'],
        "time is '0,5', expected a finite number, with a decimal point",
    ),
    "quote that does not end": ([HEADER, '0,"1,1,1'], "line 2: unexpected end of data"),
    "digits in groups": ([HEADER, *ROWS, "9, 1_0, 1, 1"], "line 10: x is '1_0', expected"),
    "nanoseconds": (
        [HEADER, *(f"{1403636580000000000 + 100000000 * k},0,0,1" for k in range(6))],
        "looks like nanoseconds, expected seconds",
    ),
    "microseconds": ([HEADER, *(f"{20000 * k},0,0,1" for k in range(6))], "like microseconds"),
    "milliseconds": ([HEADER, *(f"{20 * k},0,0,1" for k in range(6))], "like milliseconds"),
    "milliseconds of a date": (
        [HEADER, *(f"{1403636580000 + 5 * k},0,0,1" for k in range(6))],
        "looks like milliseconds",
    ),
    "too few": ([HEADER, *ROWS[:5]], "5 points, expected at least 6"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_reports_mistake_with_line(mistake: str, tmp_path: Path) -> None:
    lines, reason = MISTAKES[mistake]
    file = written(tmp_path, *lines)
    with pytest.raises(UserError) as error:
        configured_trajectory(ReferenceConfig(trajectory="csv", file=str(file)))
    assert str(error.value).startswith(f"{file}: ")
    assert reason in str(error.value)
    assert "\n" not in str(error.value)


def test_rejects_a_missing_or_binary_file(tmp_path: Path) -> None:
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff")
    for name, reason in {"nothing.csv": "cannot be read", "picture.csv": "not UTF-8"}.items():
        with pytest.raises(UserError, match=f"{name}: {reason}"):
            read_csv(tmp_path / name)
    with pytest.raises(ConfigurationError, match=r"^reference\.file: given '', expected the"):
        configured_trajectory(ReferenceConfig(trajectory="csv"))


def circle(seconds: Array) -> Array:
    return np.column_stack((2 * np.cos(seconds), 2 * np.sin(seconds), np.full(len(seconds), 2.0)))


def recording(noise: float, yaw: bool = False) -> PointTable:
    seconds = np.arange(0.0, 6.0, 0.02)
    p_WB = circle(seconds)
    p_WB += np.random.default_rng(0).normal(0.0, noise, p_WB.shape) if noise else 0.0
    angle = (seconds + np.pi) % (2.0 * np.pi) - np.pi  # jumps by a turn, as angles are recorded
    return PointTable(source="run", seconds=seconds, p_WB=p_WB, yaw=angle if yaw else None)


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 1e-4), (0.005, 0.0087), (0.02, 0.035)])
def test_noise_does_not_become_acceleration(noise: float, tolerance: float) -> None:
    """Differentiated twice as it is, 5 mm of noise at 50 Hz would be 30 m/s^2."""
    config = ReferenceConfig(path_tolerance=tolerance, max_acceleration=5.0)
    path = table_path(recording(noise), config)
    times = np.linspace(0.0, path.duration, 4001)
    samples = path.at(times)
    # It begins in motion: a way in from rest comes first.
    begin = times[np.argmin(np.linalg.norm(samples.p_WB - circle(np.zeros(1)), axis=1))]
    assert 0.2 < begin < 2.0
    inside = (times > begin + 0.3) & (times < begin + 5.5)
    distance = np.linalg.norm(samples.p_WB - circle(times - begin), axis=1)[inside]
    assert distance.max() < 0.005 + 2.5 * noise  # 2 m/s, and times 2 ms apart
    assert np.linalg.norm(samples.a_WB_W, axis=1)[inside].max() < 2.05 + 100.0 * noise
    for still in (samples.v_WB_W, samples.a_WB_W):
        assert_allclose(still[[0, -1]], np.zeros((2, 3)), atol=1e-9)


def test_recorded_yaw_is_unwound() -> None:
    path = table_path(recording(0.0, yaw=True), ReferenceConfig(max_acceleration=5.0))
    samples = path.at(np.linspace(0.0, path.duration, 2001))
    assert np.abs(samples.yaw_rate).max() < 1.2
    assert np.ptp(samples.yaw) == pytest.approx(6.0, abs=1.5)


def test_too_few_points_name_the_recording() -> None:
    seconds = np.arange(5.0)
    with pytest.raises(UserError, match="run: 5 points, expected at least 6"):
        PointTable(source="run", seconds=seconds, p_WB=np.zeros((5, 3)))
