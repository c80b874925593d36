"""Measure again and publish: bench/performance.json, docs/performance.md and its picture.

python tools/update_performance.py [OPTIONS of quad_mpc bench]
python tools/update_performance.py --page-only    # from the figures recorded last

The JSON holds every figure of the page; a test fails while the page is not what it gives.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from quad_mpc_ros.cli import main
from quad_mpc_ros.commands.bench import PICTURE, RESULT
from quad_mpc_ros.commands.output import default_out
from quad_mpc_ros.experiments.bench.page import page
from quad_mpc_ros.experiments.bench.picture import write_picture

ROOT = Path(__file__).resolve().parents[1]
RECORD = ROOT / "bench" / RESULT
PAGE = ROOT / "docs" / "performance.md"
PEERS = ("controller", "bench/peers/acados.py", "paper", "bench/peers/cvxpy.py")
_PAGE_ONLY = "--page-only"


def update(options: list[str]) -> int:
    """Measure, unless with --page-only, and publish what is recorded; return the exit code."""
    if options != [_PAGE_ONLY]:
        out = default_out("bench")
        failure = main(["bench", "--peers", *PEERS, *options, "--out", str(out)])
        if failure:
            return failure
        RECORD.write_bytes((out / RESULT).read_bytes())
    PAGE.write_text(page_of_record(), encoding="utf-8")
    write_picture(_recorded(), ROOT / "docs" / "images" / PICTURE)
    print(f"{PAGE.relative_to(ROOT)} is renewed")
    return 0


def page_of_record() -> str:
    """Return the page of the recorded measurements."""
    return page(_recorded(), picture=f"images/{PICTURE}")


def _recorded() -> dict[str, object]:
    result: dict[str, object] = json.loads(RECORD.read_text(encoding="utf-8"))
    return result


if __name__ == "__main__":
    sys.exit(update(sys.argv[1:]))
