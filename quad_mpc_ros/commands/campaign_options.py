# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Options, workers and resuming of the commands that fly campaigns."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.run_options import add_config, add_out, add_set
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers


T = TypeVar("T")


def add_campaign_options(parser: argparse.ArgumentParser, kind: str) -> None:
    """Add the file of a campaign or a study, its folder, the workers and the overrides."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help=f"file or name of a shipped {kind} (docs/howto/campaigns.md); omit with --resume",
    )
    add_out(parser, f"the {kind}; must not contain one yet", "<name of the file>")
    parser.add_argument(
        "--resume", type=Path, metavar="DIR", help=f"continue the {kind} in a folder"
    )
    add_engine_options(parser)
    add_config(parser, "that overrides the file")
    add_set(parser, "set one parameter; overrides the file")


def new_or_resumed(
    options: argparse.Namespace,
    kind: str,
    *,
    read: Callable[[], T],
    read_folder: Callable[[Path], T],
    overrides: bool,
) -> T:
    """Return the campaign or study of the options.

    Raises :class:`UserError` if a new folder is not empty, or if ``--resume`` is combined with a
    file, a folder or ``overrides``.
    """
    out: Path | None = options.out
    if options.resume is not None:
        if overrides or options.file is not None or out is not None:
            raise UserError(
                f"--resume: the {kind} in {options.resume} continues unchanged: omit FILE, "
                f"--out and options that change the {kind}"
            )
        return read_folder(options.resume)
    if options.file is None:
        raise UserError(f"FILE: expected the file of a {kind}, or --resume DIR")
    asked = read()
    if out is not None and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(
            f"--out: {out} exists and is not overwritten; give a new folder, or continue with "
            f"--resume {out}"
        )
    return asked


@contextlib.contextmanager
def campaign_folder(options: argparse.Namespace, holds: Sequence[str]) -> Iterator[Path]:
    """Yield the folder of ``--resume``, or a new folder; call this after all other checks.

    Raises :class:`UserError` if the folder cannot be written.
    """
    resumed: Path | None = options.resume
    out = resumed or prepared_out(options.out or create_out(options.file.stem), holds=holds)
    with results_in(out):
        yield out


def add_engine_options(parser: argparse.ArgumentParser) -> None:
    """Add the choice of workers."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="number of processes on this machine (default: one for each processor)",
    )


def engine_of(options: argparse.Namespace) -> LocalWorkers:
    """Return the workers of the options. Raises :class:`UserError` for less than one worker."""
    from quad_mpc_ros.extras.campaigns.local_workers import LocalWorkers

    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers: given {options.workers}, expected a number >= 1")
    return LocalWorkers(options.workers)
