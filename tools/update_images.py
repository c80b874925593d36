# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of README and of the pages on reproduction, references and racing.

python tools/update_images.py
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from quad_mpc_ros.analysis.figures import write_figures
from quad_mpc_ros.analysis.figures.reference_figure import write_reference
from quad_mpc_ros.cli import main
from quad_mpc_ros.extras.racing.gate_path import configured_course
from quad_mpc_ros.recordings.recording import Recording
from quad_mpc_ros.references.config import TRAJECTORIES, ReferenceConfig
from quad_mpc_ros.references.configured import judged_trajectory

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"

REFERENCE_DPI = 100
# What a picture of the default would not show.
REFERENCE_CHANGES: dict[str, dict[str, object]] = {
    "minimum_snap": {"max_acceleration": 8.0},
    "gates": {"gates": "seven_gates", "max_acceleration": 6.0},
}


def update_flights() -> None:
    """Fly the paper's square and copy the pictures to where the pages look."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "paper")
        main(["simulate", "--config", "paper", "--out", str(out)])
        pictures = write_figures(Recording(out / "bag").flight(), Path(scratch, "figures"))
        for picture in pictures:
            if picture.name != "path.png":  # no page shows it
                (IMAGES / f"paper_{picture.name}").write_bytes(picture.read_bytes())


def update_references() -> None:
    """Draw every reference with the required throttle and rates."""
    with tempfile.TemporaryDirectory() as scratch:
        for name in TRAJECTORIES:
            changes = {"trajectory": name, **REFERENCE_CHANGES.get(name, {})}
            if name == "csv":
                changes["file"] = str(_helix(Path(scratch)))
            config = ReferenceConfig.build(changes)
            _, verdict = judged_trajectory(config)
            picture = IMAGES / f"reference_{name}.png"
            write_reference(
                name,
                verdict,
                picture,
                course=configured_course(config),
                dpi=REFERENCE_DPI,
            )


def update_races() -> None:
    """Plan the shipped courses and fly them."""
    with tempfile.TemporaryDirectory() as scratch:
        for name in ("split_s", "seven_gates"):
            plan, run = Path(scratch, f"{name}.csv"), Path(scratch, name)
            vehicle = ["--config", "vehicles/cpc"]
            main(["plan", name, *vehicle, "--out", str(plan)])
            if name == "split_s":
                drawn = plan.with_suffix(".png").read_bytes()
                (IMAGES / f"race_{name}_plan.png").write_bytes(drawn)
            flown = ["--gates", name, "--set", f"reference.file={plan}", "--duration", "19"]
            main(["simulate", *vehicle, *flown, "--out", str(run)])
            picture = Path(run, "figures", "path.png")
            (IMAGES / f"race_{name}.png").write_bytes(picture.read_bytes())


def _helix(folder: Path) -> Path:
    """Write a table of a helix with the nose ahead, the example of docs/howto/references.md."""
    lines = ["time [s], x [m], y [m], z [m], yaw [rad]"]
    for time in np.arange(0.0, 8.01, 0.1):
        x, y, z = 2.0 * np.cos(time), 2.0 * np.sin(time), 1.0 + 0.25 * time
        lines.append(f"{time:.1f}, {x:.3f}, {y:.3f}, {z:.3f}, {time + np.pi / 2.0:.3f}")
    table = folder / "helix.csv"
    table.write_text("\n".join(lines) + "\n")
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--references", action="store_true", help="only those of the references")
    parser.add_argument("--races", action="store_true", help="only those of the races")
    options = parser.parse_args()
    if not (options.references or options.races):
        update_flights()
    if options.references or not options.races:
        update_references()
    if options.races or not options.references:
        update_races()
