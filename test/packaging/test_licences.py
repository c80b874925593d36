# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every source file names its copyright and its licence."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("bench", "docs", "examples", "launch", "quad_mpc_ros", "test", "tools")
SUFFIXES = {".c", ".css", ".py", ".sh"}
OTHERS = (".ci/run", "Dockerfile", "Makefile", "setup.py")


def test_every_source_file_begins_with_copyright_and_licence() -> None:
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
    sources = [path for path in found if path.suffix in SUFFIXES]
    assert len(sources) > 100
    missing = [
        str(path.relative_to(ROOT))
        for path in (*sources, *(ROOT / name for name in OTHERS))
        if not has_header(path)
    ]
    assert not missing


def has_header(path: Path) -> bool:
    lines = path.read_text().splitlines()
    begin = lines[1:3] if lines[0].startswith("#!") else lines[:2]
    return [line.strip("#/* ") for line in begin] == [
        "Copyright 2026 quad_mpc_ros contributors",
        "SPDX-License-Identifier: Apache-2.0",
    ]
