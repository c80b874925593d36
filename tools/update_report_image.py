# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly twice, and write the image of the page on reports.

python tools/update_report_image.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from quad_mpc_ros.analysis.figures import panels
from quad_mpc_ros.analysis.figures.over_time import FlightFigure, write_flights
from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.recording import Recording

IMAGE = Path(__file__).resolve().parents[1] / "docs" / "images" / "report.png"
FIGURE = FlightFigure(name="error", title="Tracking error", panels=panels.error_panels)


def update() -> None:
    """Simulate the square with enough iterations and with too few, and draw both errors."""
    with tempfile.TemporaryDirectory() as scratch:
        flights = {}
        for name, most in (("square", 400), ("too_few_iterations", 30)):
            limit = ["--config", "agile", "--set", f"mpc.advanced.solver.max_iterations={most}"]
            out = Path(scratch, name)
            flight = ["--start", "reference", "--duration", "8", "--out", str(out)]
            main(["simulate", *limit, *flight])
            flights[name] = Recording(out / "bag").flight()
        write_flights(FIGURE, flights, IMAGE)


if __name__ == "__main__":
    update()
