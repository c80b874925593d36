"""The table of a campaign: what is written is read again, by us and by others."""

import csv
import math

import numpy as np
import pytest

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.experiments.campaigns.table import has_parquet, read_table, write_table

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
    row(2, crashed=True, crash="ground", crash_time_s=1.25),
    row(0, position_rmse_m=None),
    row(1, error="not, at all", position_rmse_m=None, fallbacks=None),
]


def test_numbers_come_back_with_every_digit_and_in_order(tmp_path):
    write_table(tmp_path, ROWS, NAMES)
    table = read_table(tmp_path)
    assert table.columns["flight"].tolist() == [0, 1, 2]
    assert table.columns["position_rmse_m"][2] == 1.0 / 3.0
    assert math.isnan(table.columns["position_rmse_m"][0])
    assert table.columns["error"].tolist() == ["", "not, at all", ""]
    assert table.crashed.tolist() == [False, False, True]
    assert table.flown.tolist() == [True, False, True]
    assert table.varied == ("mpc.R.1", "reference.trajectory")
    assert table.figures == ("position_rmse_m", "fallbacks")


def test_the_order_of_the_rows_changes_no_byte(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    for folder, rows in ((first, ROWS), (second, ROWS[::-1])):
        folder.mkdir()
        write_table(folder, rows, NAMES)
    for file in first.iterdir():
        assert file.read_bytes() == (second / file.name).read_bytes()


@pytest.mark.skipif(not has_parquet(), reason="pyarrow is an extra")
def test_parquet_holds_what_the_csv_holds(tmp_path):
    import pyarrow.parquet

    write_table(tmp_path, ROWS, NAMES)
    parquet = pyarrow.parquet.read_table(tmp_path / "flights.parquet").to_pylist()
    with (tmp_path / "flights.csv").open(newline="") as file:
        for wanted, found in zip(csv.DictReader(file), parquet, strict=True):
            assert list(wanted) == list(found) == NAMES
            for name, cell in wanted.items():
                value = found[name]
                text = "" if value is None else str(int(value) if name == "crashed" else value)
                assert text == cell


def test_a_campaign_without_flights_is_a_table(tmp_path):
    write_table(tmp_path, [], NAMES)
    table = read_table(tmp_path)
    assert len(table) == 0
    assert np.sum(table.crashed) == 0


def test_another_table_is_refused(tmp_path):
    (tmp_path / "flights.csv").write_text("a,b\n1,2\n")
    with pytest.raises(UserError, match="not the table of a campaign"):
        read_table(tmp_path)
    with pytest.raises(UserError, match="no table"):
        read_table(tmp_path / "nowhere")


@pytest.mark.parametrize("line", ["1", "1,2,3,4,5,6,7,8,9,10", "first,,,,0,,,,", "1.5,,,,0,,,,"])
def test_a_table_with_a_broken_line_is_refused(line, tmp_path):
    (tmp_path / "flights.csv").write_text(",".join(NAMES) + f"\n0,,,,0,,,,\n{line}\n")
    with pytest.raises(UserError, match="not the table of a campaign"):
        read_table(tmp_path)
