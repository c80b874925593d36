# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fly, identify and resolve, and write the figures of the pages on identify and resolve.

python tools/update_recording_images.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from quad_mpc_ros.cli import main

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
MANIFOLD = ("mpc.formulation=manifold", "mpc.terminal_weight=30")
LAGS = (
    "simulator.rate_time_constant=0.03",
    "simulator.thrust_time_constant=0.04",
    "simulator.command_delay=0.02",
    "simulator.mass_scale=1.2",
)
NOISE = (
    "simulator.position_noise=0.01",
    "simulator.attitude_noise=0.0087",
    "simulator.velocity_noise=0.05",
    "simulator.rate_noise=0.02",
)


def update() -> None:
    """Simulate, draw, and copy the pictures to where the pages look for them."""
    with tempfile.TemporaryDirectory() as scratch:
        lagged = Path(scratch, "lagged")
        main(["simulate", *_set(*MANIFOLD, *LAGS, *NOISE), "--out", str(lagged)])
        picture = str(IMAGES / "identify.png")
        main(["identify", str(lagged), "--plot", picture, "--overwrite"])

        flown, again = Path(scratch, "flown"), Path(scratch, "again")
        main(["simulate", "--config", "paper_rigid_body", "--duration", "6", "--out", str(flown)])
        main(["resolve", str(flown), *_set(*MANIFOLD), "--out", str(again)])
        (IMAGES / "resolve.png").write_bytes((again / "figures" / "commands.png").read_bytes())


def _set(*assignments: str) -> list[str]:
    return [part for assignment in assignments for part in ("--set", assignment)]


if __name__ == "__main__":
    update()
