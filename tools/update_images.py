"""Fly the paper's square on both plants and write the figures of README and docs/reproduction.md.

python tools/update_images.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from quad_mpc_ros.analysis import read_flight, write_comparison, write_figures
from quad_mpc_ros.cli import main

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
PRESETS = {"paper": "Eq. (3) as printed", "paper_rigid_body": "true rigid body"}


def update() -> None:
    """Simulate, draw, and copy the pictures to where the pages look for them."""
    flights = {}
    with tempfile.TemporaryDirectory() as scratch:
        for preset, title in PRESETS.items():
            out = Path(scratch, preset)
            main(["simulate", "--config", preset, "--out", str(out)])
            flights[title] = read_flight(out / "bag")
        pictures = write_figures(flights[PRESETS["paper"]], Path(scratch, "figures"))
        for picture in pictures:
            name = "square.png" if picture.name == "path.png" else f"paper_{picture.name}"
            (IMAGES / name).write_bytes(picture.read_bytes())
    write_comparison(flights, IMAGES / "paper_and_rigid_body.png")


if __name__ == "__main__":
    update()
