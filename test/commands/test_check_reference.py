# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc check-reference`` as a user runs it, and a recorded run as a reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.cli import main


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--reference", "vertical_loop"], 0, ["highest throttle", "pitch rate", "\nfeasible"]),
        (
            ["--reference", "lemniscate", "--set", "reference.angular_frequency=3"],
            1,
            ["not feasible: highest throttle 1.166", "; roll rate 32.75", "mpc.omega_max"],
        ),
        (
            ["--reference", "lemniscate", "--set", "reference.angular_frequency=2.6"],
            0,
            ["\nfeasible", "note: roll rate 21.37 rad/s is beyond mpc.omega_max, 18.85"],
        ),
        (["--config", "paper"], 1, ["square", "not feasible: 3 jumps"]),
    ],
)
def test_the_verdict_is_printed_and_drawn(
    arguments: list[str],
    code: int,
    message: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "check"

    assert main(["check-reference", *arguments, "--out", str(out)]) == code

    printed = capsys.readouterr().out
    for words in message:
        assert words in printed
    assert (out / "reference.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("node", ["/**", "/**/mpc"])
@pytest.mark.parametrize(
    ("limit", "complaint"),
    [
        ("omega_max: [5.0, 5.0, 2.0]", "not feasible: pitch rate"),
        ("throttle_max: 0.4", "not feasible: highest throttle"),
    ],
)
def test_compares_a_reference_with_the_limits_of_the_vehicle_file(
    node: str, limit: str, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "vehicle.yaml"
    file.write_text(f"{node}: {{ros__parameters: {{{limit}}}}}\n")
    flip = ["check-reference", "--reference", "flip", "--out", str(tmp_path / "out")]
    assert main([*flip, "--config", str(file)]) == 1
    assert complaint in capsys.readouterr().out
