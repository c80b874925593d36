# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The table of a campaign, read with the csv module."""

import csv

from quad_mpc_ros.extras.campaigns.table import write_table

NAMES = ["flight", "mpc.R.1", "reference.trajectory", "error", "crashed", "crash", "crash_time_s"]
NAMES += ["position_rmse_m", "fallbacks"]


def row(number, **values):
    given = {
        "flight": number,
        "mpc.R.1": 0.1 + 1e-17 * number,
        "reference.trajectory": "hover",
        "crashed": False,
        "position_rmse_m": 1.0 / 3.0,
        "fallbacks": 0,
    }
    return given | values


ROWS = [
    row(0, position_rmse_m=None),
    row(1, error="not, at all", position_rmse_m=None, fallbacks=None),
    row(2, crashed=True, crash="ground", crash_time_s=1.25),
]


def test_writes_rows_with_every_digit(tmp_path):
    write_table(tmp_path, ROWS, NAMES)
    with (tmp_path / "flights.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == NAMES
    assert [int(row[0]) for row in rows] == [0, 1, 2]
    table = dict(zip(NAMES, zip(*rows, strict=True), strict=True))
    assert float(table["position_rmse_m"][2]) == 1.0 / 3.0
    assert table["position_rmse_m"][0] == ""
    assert table["error"] == ("", "not, at all", "")
    assert table["crashed"] == ("0", "0", "1")
