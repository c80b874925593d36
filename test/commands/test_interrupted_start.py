# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C during the start of a program ends it by the signal or with exit code 130."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fixtures.setup_py import executable

PROGRAMS = {
    "quad_mpc --help": [*executable("quad_mpc"), "--help"],
    "quad_mpc simulate": [*executable("quad_mpc"), "simulate", "--duration", "300"],
    "mpc_node": executable("mpc_node"),
    "reference_node": [*executable("reference_node"), "--ros-args", "-p", "trajectory:=square"],
}
INSTANTS = (0.0, 0.1, 0.4, 1.0)  # s: within imports, making the node, flying


def catches_interrupts(pid: int) -> bool:
    """Whether a process has a handler of its own for SIGINT, as Python sets one when it starts."""
    mask = re.search(r"^SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    return mask is None or bool(int(mask[1], 16) >> (signal.SIGINT - 1) & 1)


def interrupted(command: list[str], after: float, folder: Path) -> tuple[int, str]:
    """Return exit code and errors of a program, interrupted so long after its first own line.

    Before that, Python itself starts, whose messages are not ours.
    """
    python, option, program, *arguments = command
    begins = "import sys; sys.stderr.write('begun\\n'); sys.stderr.flush(); "
    process = subprocess.Popen(
        [python, "-P", option, begins + program, *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "begun\n"
    while process.poll() is None and catches_interrupts(process.pid):
        time.sleep(0.0005)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(after)
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    return process.returncode, errors


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("program", PROGRAMS)
def test_an_interrupted_start_ends_without_a_traceback(program: str, tmp_path: Path) -> None:
    for instant in INSTANTS:
        code, errors = interrupted(PROGRAMS[program], instant, tmp_path)
        said = r"\[INFO\]|simulating | +[\d.]+ s of 300 s "  # by then it may have begun
        lines = [line for line in errors.splitlines() if line and not re.match(said, line)]
        assert lines in ([], ["interrupted"]) or "compile cache" in errors, (instant, errors)
        # 0: what it was asked for was done, or the node had started and was ended.
        assert code in (-signal.SIGINT, 130, 0), (instant, errors)
        assert "Traceback" not in errors, instant
