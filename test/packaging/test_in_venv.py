# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""tools/in_venv.sh, the work behind ``make``, with a stand-in for Python that installs nothing."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PROJECT = [
    "Makefile", "tools", "setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE",
    "resource", "config", "launch",
]  # fmt: skip

# Makes "environments" whose Python is itself; pip calls are appended to pip.txt.
PYTHON = """\
#!/bin/sh
case "$*" in
  *version_info*) echo {version} ;;
  "-m venv"*)
    for folder; do :; done
    mkdir -p "$folder/bin"
    ln -s "$(readlink -f "$0")" "$folder/bin/python"
    printf '#!/bin/sh\\necho flying "$@"\\n' >"$folder/bin/quad_mpc"
    chmod +x "$folder/bin/quad_mpc"
    ;;
  *"-m pip"*)
    echo "$@" >>{pip}
    {on_pip}
    ;;
  *ensurepip*) {on_ensurepip} ;;
esac
"""


@dataclass
class Outcome:
    status: int
    text: str


class Checkout:
    """A copy of what ``make run`` needs, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = folder / "bin" / "python3"
        self.pip_calls = folder / "pip.txt"
        for name in PROJECT:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
        (folder / "quad_mpc_ros").mkdir()
        (folder / "quad_mpc_ros" / "__init__.py").write_text('__version__ = "0.1.0"\n')
        (folder / "bin").mkdir()
        self.be_machine("x86_64")
        self.install_python()

    def be_machine(self, machine: str) -> None:
        self.write_program("uname", f'#!/bin/sh\n[ "$1" = -m ] && echo {machine} || echo Linux\n')

    def install_python(
        self, *, version: str = "3.11", on_pip: str = ":", on_ensurepip: str = ":"
    ) -> None:
        self.write_program(
            self.python.name,
            PYTHON.format(
                version=version, pip=self.pip_calls, on_pip=on_pip, on_ensurepip=on_ensurepip
            ),
        )

    def write_program(self, name: str, text: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(text)
        path.chmod(0o755)

    def make(self, target: str = "run", **variables: str) -> Outcome:
        """Run make in a plain environment: no ROS, and of Python only the stand-in."""
        environment = {
            "PATH": f"{self.folder / 'bin'}:/usr/local/bin:/usr/bin:/bin",
            "HOME": str(self.folder),
            "PYTHON": str(self.python),
            **variables,
        }
        done = subprocess.run(
            ["make", target], cwd=self.folder, env=environment, text=True, check=False,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True,  # for the stand-in that kills its group
        )  # fmt: skip
        return Outcome(done.returncode, done.stdout)

    def pip(self) -> list[str]:
        """Return what pip was called with since the last time."""
        calls = self.pip_calls.read_text().splitlines() if self.pip_calls.exists() else []
        self.pip_calls.unlink(missing_ok=True)
        return calls


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def test_first_run_installs_and_second_run_does_not(checkout: Checkout) -> None:
    first = checkout.make(ARGS="--duration 2")
    assert first.status == 0
    assert first.text.endswith("flying fly --duration 2\n")
    (call,) = checkout.pip()
    assert call.endswith("[ros]")
    assert checkout.make().text == "flying compile\nflying fly\n"
    assert checkout.pip() == []


def test_source_change_reinstalls_only_this_package(checkout: Checkout) -> None:
    checkout.make()
    checkout.pip()
    (checkout.folder / "config" / "new.yaml").touch()
    assert checkout.make().status == 0
    (call,) = checkout.pip()
    assert "--no-deps" in call
    assert checkout.make().text == "flying compile\nflying fly\n"


def test_change_of_the_dependencies_installs_them_with_all_extras(checkout: Checkout) -> None:
    checkout.make()
    assert checkout.make("test").status == 0
    checkout.pip()
    with (checkout.folder / "setup.py").open("a") as setup:
        setup.write("# one more dependency\n")
    assert checkout.make().status == 0
    (call,) = checkout.pip()
    assert call.endswith("[ros,test]")


@pytest.mark.parametrize("installed", ["Collecting numpy", "Installing collected packages: numpy"])
def test_killed_install_is_restarted(checkout: Checkout, installed: str) -> None:
    checkout.install_python(on_pip=f"echo '{installed}'; sleep 1; kill -9 0")
    assert checkout.make().status != 0
    checkout.install_python()
    checkout.pip()
    second = checkout.make()
    assert second.text.startswith("Making the virtual environment")
    assert second.text.endswith("flying fly\n")
    assert len(checkout.pip()) == 1


def test_failed_install_reports_the_reason_and_is_retried(checkout: Checkout) -> None:
    checkout.install_python(on_pip="echo 'ERROR: No matching distribution found for osqp'; exit 1")
    failed = checkout.make()
    assert failed.status != 0
    assert "ERROR: No matching distribution found for osqp\npip could not install" in failed.text
    checkout.install_python()
    assert checkout.make().text.endswith("flying fly\n")


def test_environment_without_its_python_is_recreated(checkout: Checkout) -> None:
    checkout.make()
    python = checkout.folder / ".venv" / "bin" / "python"
    python.unlink()
    python.symlink_to("/nonexistent/python3")
    assert checkout.make().text.endswith("flying fly\n")
    assert len(checkout.pip()) == 2


def test_leaves_a_foreign_folder_untouched(checkout: Checkout) -> None:
    (checkout.folder / ".venv").mkdir()
    refused = checkout.make()
    assert refused.status != 0
    assert "was not made by make" in refused.text


def test_missing_python_is_named(checkout: Checkout) -> None:
    missing = checkout.make(PYTHON="/nonexistent")
    assert missing.status != 0
    assert "3.11 or 3.12 or 3.13" in missing.text
    assert "/nonexistent: not found" in missing.text
    assert "sudo apt install python3 python3-venv" in missing.text


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_sourced_ros_is_used_instead_of_the_wheels(checkout: Checkout, distribution: str) -> None:
    jazzy = {"ROS_DISTRO": distribution, "AMENT_PREFIX_PATH": f"/opt/ros/{distribution}"}
    assert checkout.make(**jazzy).text.endswith("flying fly\n")
    (call,) = checkout.pip()
    assert "[ros]" not in call
    assert checkout.make(**jazzy).text == "flying compile\nflying fly\n"


def test_another_sourced_ros_is_refused(checkout: Checkout) -> None:
    refused = checkout.make(ROS_DISTRO="humble", AMENT_PREFIX_PATH="/opt/ros/humble")
    assert refused.status != 0
    assert "ROS 2 humble is sourced" in refused.text
