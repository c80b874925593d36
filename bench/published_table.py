# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of benches that fly a published table: options, parallel flights, output."""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from markdown_table import markdown_table


class Flown(Protocol):
    """Result of a flight: the RMSE of the true position [m], and the flight."""

    @property
    def rmse(self) -> float: ...
    @property
    def name(self) -> str: ...
    def cells(self) -> dict[str, Any]:
        """Return the result as a row of ``flights.csv``."""
        ...


Job = TypeVar("Job")
Result = TypeVar("Result", bound=Flown)


def parser(doc: str | None, *, name: str, rows: Iterable[str]) -> argparse.ArgumentParser:
    """Return a parser with the options that every table has."""
    made = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--out", type=Path, default=Path("runs", name))
    made.add_argument("--workers", type=int, default=2)
    made.add_argument("--rows", nargs="*", choices=[*rows], default=[*rows])
    made.add_argument("--config", nargs="*", default=[])
    made.add_argument("--set", nargs="*", default=[])
    return made


def all_flown(fly: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> list[Result]:
    """Fly in parallel processes, with a line of progress now and then."""
    done: list[Result] = []
    begun = time.monotonic()
    # Ctrl-C is for this process, which ends the others.
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with multiprocessing.Pool(workers, signal.signal, ignore) as pool:
        for each in pool.imap(fly, jobs, chunksize=2):
            done.append(each)
            if len(done) % 20 == 0 or len(done) == len(jobs):
                seconds = time.monotonic() - begun
                line = f"{len(done)}/{len(jobs)} after {seconds:.0f} s: {each.name}"
                print(line, file=sys.stderr, flush=True)
    return done


def write(out: Path, done: Sequence[Flown], lines: Sequence[Sequence[str]]) -> None:
    """Write every flight and the table, whose first line is its header; print the worst five."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / "flights.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, done[0].cells())
        writer.writeheader()
        writer.writerows(each.cells() for each in done)
    with (out / "table.csv").open("w", newline="") as file:
        csv.writer(file).writerows(lines)
    table = markdown_table(lines[0], lines[1:])
    (out / "table.md").write_text(f"{table}\n", encoding="utf-8")
    print(table)
    for each in sorted(done, key=lambda flight: -flight.rmse)[:5]:
        print(f"{each.rmse:.4f} m  {each.name}")
