# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What setup.py, package.xml and the code say of the package must agree."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from catkin_pkg.package import Package, parse_package
from fixtures.setup_py import declared, setup_arguments

import quad_mpc_ros
from quad_mpc_ros import entry
from quad_mpc_ros.ros.bridges.registry import load_bridge

ROOT = Path(__file__).parents[2]

# Python packages that are imported by another name than they are installed by.
IMPORT_NAMES = {
    "PyYAML": "yaml",
    "python3-yaml": "yaml",
    "python3-catkin-pkg-modules": "catkin_pkg",
    "python3-pytest-timeout": "pytest_timeout",
}
# Packages that come inside another one.
COMES_WITH = {"mpl_toolkits": "matplotlib", "mcap_ros2": "mcap-ros2-support"}
# Messages of flight stacks and parts of ROS, in tests that are skipped without them.
INSTALLED_BY_OTHERS = {"crazyflie_interfaces", "rosbag2_interfaces", "rosidl_adapter"}


@pytest.fixture(scope="module")
def package_xml() -> Package:
    return parse_package(str(ROOT))


def imports_of(folder: Path) -> dict[str, str]:
    """Return every imported top-level package outside the standard library, and one user."""
    found = {}
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            for name in imported_names(node):
                top = name.partition(".")[0]
                top = COMES_WITH.get(top, top)
                if top not in sys.stdlib_module_names and top != "quad_mpc_ros":
                    found[top] = str(path.relative_to(ROOT))
    return found


def imported_names(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
        yield node.module


def import_name(requirement: str) -> str:
    distribution = re.match(r"[\w-]+", requirement)
    assert distribution, requirement
    return IMPORT_NAMES.get(distribution[0], distribution[0].removeprefix("python3-"))


def ros_dependencies(package_xml: Package) -> set[str]:
    return {import_name(dependency.name) for dependency in package_xml.exec_depends}


def python_dependencies() -> set[str]:
    return {import_name(each) for each in setup_arguments()["install_requires"]}


def test_package_xml_is_valid_and_of_ament_python(package_xml: Package) -> None:
    # colcon does not report an invalid one: it installs a plain Python package instead.
    package_xml.validate()
    assert package_xml.package_format == 3
    assert package_xml.get_build_type() == "ament_python"


def test_version_is_the_same_everywhere(package_xml: Package) -> None:
    assert package_xml.version == quad_mpc_ros.__version__
    assert f"\nversion: {package_xml.version}\n" in (ROOT / "CITATION.cff").read_text()


def test_setup_and_package_xml_describe_the_same_package(package_xml: Package) -> None:
    (maintainer,) = package_xml.maintainers
    assert setup_arguments()["maintainer"] == maintainer.name
    assert setup_arguments()["maintainer_email"] == maintainer.email
    assert [setup_arguments()["license"]] == package_xml.licenses
    assert [each.name for each in package_xml.authors] == [setup_arguments()["author"]]


@pytest.mark.parametrize(("name", "target"), declared("console_scripts").items())
def test_every_executable_has_its_main_function(name: str, target: str) -> None:
    assert target == f"quad_mpc_ros.entry:{name}"
    assert callable(getattr(entry, name))
    if name in declared("quad_mpc_ros.bridges"):
        assert load_bridge(name).name == name
    else:
        assert callable(importlib.import_module(entry.module_of(name)).main)


def test_every_import_of_the_package_is_declared(package_xml: Package) -> None:
    known = ros_dependencies(package_xml) | python_dependencies()
    undeclared = {
        name: user for name, user in imports_of(ROOT / "quad_mpc_ros").items() if name not in known
    }
    assert undeclared == {}


def test_every_message_type_is_of_a_declared_package(package_xml: Package) -> None:
    # ROS imports them by name; bags only knows the names, and bridges say themselves what they
    # need and how to get it.
    for path in (ROOT / "quad_mpc_ros" / "ros").rglob("*.py"):
        if "bridges" not in path.parts:
            packages = set(re.findall(r'"(\w+)/(?:msg|srv)/\w+"', path.read_text()))
            assert packages <= ros_dependencies(package_xml), path


def test_every_import_of_the_launch_files_is_declared(package_xml: Package) -> None:
    assert imports_of(ROOT / "launch").keys() <= ros_dependencies(package_xml)


def test_every_python_dependency_is_used() -> None:
    assert python_dependencies() <= imports_of(ROOT / "quad_mpc_ros").keys()


def requirements() -> list[str]:
    lines = (ROOT / "requirements.txt").read_text().splitlines()
    return [line for line in lines if not line.startswith("#")]


def test_requirements_and_package_xml_name_all_python_dependencies(package_xml: Package) -> None:
    declared_ones = setup_arguments()["install_requires"]
    assert set(requirements()) <= set(declared_ones)
    listed = {import_name(each) for each in requirements()}
    assert listed | ros_dependencies(package_xml) >= python_dependencies()
    # Also where rosdep was not run: these come with osqp, osqp and ROS 2.
    assert listed | {"numpy", "scipy", "yaml"} == python_dependencies()


@pytest.mark.parametrize("page", ["README.md", "Dockerfile"])
def test_requirements_are_installed_with_one_line_after_rosdep(page: str) -> None:
    text = (ROOT / page).read_text()
    rosdep, pip = text.index("rosdep install"), text.index("src/quad_mpc_ros/requirements.txt")
    assert rosdep < pip < text.rindex("quad_mpc compile")
    assert "pip install" in text[rosdep : pip + 1]


def test_every_import_of_the_tests_is_declared(package_xml: Package) -> None:
    extras = setup_arguments()["extras_require"]
    optional = {import_name(name) for extra in extras.values() for name in extra}
    known = ros_dependencies(package_xml) | python_dependencies() | optional
    known |= {import_name(each.name) for each in package_xml.test_depends}
    ours = {path.stem for folder in ("test", "bench") for path in (ROOT / folder).glob("*")}
    undeclared = imports_of(ROOT / "test").keys() - known - ours - INSTALLED_BY_OTHERS
    assert undeclared == set()


def test_package_xml_names_website_repository_and_bugtracker(package_xml: Package) -> None:
    assert {url.type for url in package_xml.urls} == {"website", "repository", "bugtracker"}
