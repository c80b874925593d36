"""``quad_mpc replay``: the player node on this terminal."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from quad_mpc_ros.commands.processes import require_ros, run_in_foreground
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.recordings.config import PlayerConfig


def replay(options: argparse.Namespace) -> int:
    """Play a bag until its end or Ctrl-C; return the exit code of the player."""
    remaps = [argument for rule in options.remap for argument in ("-r", _remap(rule))]
    given = {
        spec.name: value
        for spec in PlayerConfig.specs()
        if (value := getattr(options, spec.name, None)) is not None
    }
    PlayerConfig.build(given)
    require_ros("replay")
    values = {**given, "progress": True}
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder, "player.yaml")
        parameters.write_text(files.dump("player", values), encoding="utf-8")
        return run_in_foreground("player", ["--params-file", str(parameters), *remaps])


def _remap(rule: str) -> str:
    source, separator, target = rule.partition(":=")
    if not (source and separator and target):
        raise UserError(f"--remap: given {rule!r}, expected FROM:=TO")
    return rule
