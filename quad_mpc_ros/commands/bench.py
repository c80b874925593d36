"""``quad_mpc bench``: this controller beside others, on the same flight in one process."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from quad_mpc_ros.bench.page import page
from quad_mpc_ros.bench.picture import write_picture
from quad_mpc_ros.bench.run import run
from quad_mpc_ros.bench.tables import as_text, comparison_lines, horizon_rows, peer_rows, swept
from quad_mpc_ros.commands.bench_options import (
    PAGE,
    PICTURE,
    RESULT,
    bench_command,
    resolve_bench,
)
from quad_mpc_ros.commands.run_options import default_out, prepared_out
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.simulation.plants import make_plant


def bench(options: argparse.Namespace) -> int:
    """Fly the peers, write and show what was measured; return the exit code."""
    config = resolve_bench(options)
    make_plant(config.simulator)  # one that is not installed is told before anything flies
    out = prepared_out(options.out or default_out("bench"), holds=(RESULT, PAGE, PICTURE))
    print(f"measuring into {out}", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="quad_mpc_bench_") as scratch:
        measured = run(config, scratch=Path(scratch), tell=_tell)
    result = {"command": bench_command(options), **measured}
    _write(result, out)
    _show(result, out)
    return 0


def _tell(line: str) -> None:
    print(f"  {line}", file=sys.stderr, flush=True)


def _write(result: dict[str, Any], out: Path) -> None:
    try:
        text = json.dumps(result, indent=2, allow_nan=False)
        (out / RESULT).write_text(text + "\n", encoding="utf-8")
        (out / PAGE).write_text(page(result, picture=PICTURE), encoding="utf-8")
        write_picture(result, out / PICTURE)
    except OSError as error:
        raise UserError(f"{out}: results cannot be written: {error.strerror}") from error


def _show(result: dict[str, Any], out: Path) -> None:
    print(as_text(peer_rows(result)))
    for line in comparison_lines(result):
        print(f"\n{line}")
    if swept(result):
        print(f"\n{as_text(horizon_rows(result))}")
    print()
    for name in (RESULT, PAGE, PICTURE):
        print(out / name)
