"""Former names of parameters are refused with the present one, wherever they are given."""

from __future__ import annotations

from pathlib import Path

import pytest

from quad_mpc_ros.commands.params import own_nodes
from quad_mpc_ros.commands.run_configuration import SCHEMA
from quad_mpc_ros.configuration import Configuration, ConfigurationError, files
from quad_mpc_ros.configuration.renamed import RENAMED, with_present_names
from quad_mpc_ros.ros.bridges.betaflight.config import BetaflightConfig
from quad_mpc_ros.ros.bridges.px4 import Px4Config

NODES: dict[str, type[Configuration]] = {
    **own_nodes(),
    "px4_bridge": Px4Config,
    "bridge": BetaflightConfig,
}
EVERY = [(node, former, now) for node, names in RENAMED.items() for former, now in names.items()]


@pytest.mark.parametrize(("node", "former", "now"), EVERY)
def test_present_names_exist_and_former_ones_do_not(node: str, former: str, now: str) -> None:
    kind = NODES[node]
    names = {spec.name for spec in kind.specs()}
    assert former not in names
    assert now in names or not now
    with pytest.raises(ConfigurationError) as refusal:
        kind.build({former: 1.0})
    expected = f"renamed {kind.owner}.{now}" if now else "removed"
    assert str(refusal.value).startswith(f"{kind.owner}.{former} was {expected}")


def test_former_names_are_refused_in_files_and_assignments(tmp_path: Path) -> None:
    told = r"^mpc\.swinging\.tilt was renamed mpc\.advanced\.oscillation\.tilt_amplitude$"
    file = tmp_path / "old.yaml"
    for key in ("/**/mpc", "/**"):
        file.write_text(f"{key}: {{ros__parameters: {{swinging: {{tilt: 0.3}}}}}}\n")
        with pytest.raises(ConfigurationError, match=f"^{file}: {told.removeprefix('^')}"):
            files.load([str(file)], [], schema=SCHEMA)
    with pytest.raises(ConfigurationError, match=told):
        files.load([], ["mpc.swinging.tilt=0.3"], schema=SCHEMA)


def test_former_names_of_recordings_are_understood() -> None:
    recorded = {"solver.tolerance": 1e-4, "torque_curve": [1.0, 2.0, 3.0], "mass": 0.5}
    assert with_present_names("mpc", recorded) == {
        "advanced.solver.tolerance": 1e-4,
        "mass": 0.5,
    }
